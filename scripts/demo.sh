#!/usr/bin/env bash
# Registers the CT pair that comes with the repository and shows where the results are.
set -euo pipefail
cd "$(dirname "$0")/.."

usage() {
  cat <<'EOF'
usage: scripts/demo.sh [--output DIR] [options of `mtled register`]

Builds mtled, then registers the two postures of one thorax in data/thorax_flex from the images and the labels of the
vertebrae alone. The second posture was simulated, so that the true displacement is known: the landmarks compare with it.
Results go to output/demo, or DIR. Takes some minutes. Example: scripts/demo.sh --node-spacing 5
EOF
}

output=output/demo options=()
while [[ $# -gt 0 ]]; do
  case "$1" in
    -h|--help) usage; exit 0 ;;
    --output) output=${2:?--output needs a folder}; shift ;;
    *) options+=("$1") ;;
  esac
  shift
done

scripts/build.sh --target mtled

data=data/thorax_flex
echo
echo "Registering $data (moving.nii.gz onto fixed.nii.gz) ..."
started=$SECONDS
build/bin/mtled register \
  --moving "$data/moving.nii.gz" --fixed "$data/fixed.nii.gz" \
  --moving-labels "$data/moving_vertebrae.nii.gz" --fixed-labels "$data/fixed_vertebrae.nii.gz" \
  --landmarks "$data/landmarks.csv" --output "$output" --force "${options[@]}"

echo
echo "Done in $((SECONDS - started)) s. Open $output/report.html in a browser: it shows all of it. Single pictures:"
find "$output" -maxdepth 1 -name '*.png' | sort | sed 's/^/  /'
echo "Other results:"
find "$output" -maxdepth 1 -type f ! -name '*.png' | sort | sed 's/^/  /'
echo "View the displacement of the nodes ($output/nodes.vtu) with ParaView, the images with 3D Slicer."
