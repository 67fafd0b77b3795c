#!/bin/bash
# A floor plan from a picture: import with its marks, look for gaps, a patrol of it, a flight of the patrol in the simulator's world.
#
#   room_from_image.sh scan.png --scale 20,20,420,20,10 --home 100,150 --room west,100,150 --room east,330,120 --door west-east,222,60,222,100
#
# Marks are pixels of the picture; --scale is two points and the metres between them. See docs/plans.md. Writes into ./room/.
set -euo pipefail
picture=$1
shift
mkdir -p room
kestrel map import "$picture" "$@" -o room/plan.yaml --picture room/plan.svg
kestrel map check room/plan.yaml || echo "(flown all the same: a gap in a wall is only a wall that is not seen)"
kestrel plan room/plan.yaml -o room/patrol.plan --picture room/patrol.svg
kestrel mav mission show room/patrol.plan
echo "now: kestrel sim room/plan.yaml"
