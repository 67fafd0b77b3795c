#!/bin/bash
# A recorded flight, flown again: bit for bit as it was, then with other gains: from where on would they have commanded something else?
#
#   replay_other_gains.sh [NAME=VALUE ...]      default MPC_XY_P=0.6
set -euo pipefail
gains=("$@")
[ ${#gains[@]} -gt 0 ] || gains=(MPC_XY_P=0.6)
[ -e flight.mcap ] || kestrel demo --headless --speed max --log flight.log
kestrel log info flight.mcap
kestrel replay flight.mcap --check
for gain in "${gains[@]}"; do
    echo "--- with $gain"
    kestrel replay flight.mcap --set "$gain" || true # another command is what we look for
done
