#!/bin/sh
# Sizes from a population: scans are made, fitted, and the few cups found that serve all of them best.
#
#     sh examples/sizes_from_a_population.sh [OUT] [COUNT] [SIZES]
#
# Run in brafit's folder. The population is COUNT (12) quarter spheres of random radius and side, so that nothing has to
# be loaded; a folder of real scans takes the place of OUT/scans. Prints each of the 3 sizes with how many wear it, and
# how well they serve beside as many groups by the wire's length; OUT/sizes (OUT: runs/sizes) gets index.html, the table
# of who wears what (members.csv) and the nested patterns.
set -eu
out=${1:-runs/sizes} count=${2:-12} sizes=${3:-3}

python scripts/make_scans.py --spheres --count "$count" --points 4000 --out "$out/scans"
brafit "$out/scans" out="$out/fits" experiment=lean
brafit-sizes "$out/fits" --sizes "$sizes" --out "$out/sizes"
