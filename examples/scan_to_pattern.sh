#!/bin/sh
# From a scan to its pattern without Python: mark, look, fit. Run in a folder of your own.
#
#     sh examples/scan_to_pattern.sh SCAN [OUT] [key=value ...]
#
# SCAN is a cloud or a mesh. Makes in OUT (runs/scan_to_pattern):
#     marking/index.html      pages on which marks are moved by hand; `Save` there gives the landmark file for the next run
#     inspection/             a picture of what the fit is going to take
#     results/index.html      the results; results/NAME/patterns.pdf is the one to print
# A scan that has no landmark file is fitted with proposed landmarks: look at them before you cut.
set -eu
scan=${1:?name a scan: sh examples/scan_to_pattern.sh SCAN}
out=${2:-runs/scan_to_pattern}
[ $# -gt 2 ] && shift 2 || shift $#

brafit-mark "$scan" --out "$out/marking"
brafit-inspect "$scan" --out "$out/inspection"
brafit "$scan" scan.propose=true out="$out/results" "$@"
