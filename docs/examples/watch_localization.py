"""How sure the vehicle is of its place, live: a line whenever KESTREL_LOCALIZATION comes. Needs nothing but `kestrel`.

    kestrel sim office --start unknown &
    python watch_localization.py [connection [lines]]      default udpclient://127.0.0.1:14555 600

Start it, then let the vehicle take off (`kestrel mav takeoff 1`): it does not know where it stands, turns once, and finds out.
"""
import math
import re
import subprocess
import sys

link = sys.argv[1] if len(sys.argv) > 1 else "udpclient://127.0.0.1:14555"
lines = int(sys.argv[2]) if len(sys.argv) > 2 else 600
STATES = ["off", "searching", "localized", "lost"]

watch = subprocess.Popen(
    ["kestrel", "mav", "--to", link, "watch", "KESTREL_LOCALIZATION", "--hz", "5", "-n", str(lines)], stdout=subprocess.PIPE, text=True
)
for line in watch.stdout:
    said = {name: float(value) for name, value in re.findall(r"(\w+)[:=]? ?(-?[\d.]+(?:e-?\d+)?|NaN)", line) if value}
    if "particles" not in said:
        continue
    mass, x = said["cluster_mass"], said.get("x", math.nan)
    place = "     -      -" if math.isnan(x) else f"{x:6.2f} {said['y']:6.2f}"
    bar = "#" * round(20 * mass)
    print(f"{STATES[int(said['state'])]:<9} {place} m  sure {mass:4.2f} |{bar:<20}| fit {said['fit']:4.2f}  {said['particles']:.0f} particles", flush=True)
sys.exit(watch.wait())
