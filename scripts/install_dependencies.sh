#!/usr/bin/env bash
# Installs what mtled needs to be built and tested on Debian 12 and its relatives.
set -euo pipefail

usage() {
  cat <<'EOF'
usage: scripts/install_dependencies.sh [--with-references] [--check | --list]

Installs the Debian packages that mtled needs and that are not there yet (apt-get, with sudo when not root).
Does nothing, and needs no network, when all are there.

  --with-references   also what some tests compare mtled with or look at its reports with: SciPy, scikit-image, Matplotlib,
                      Chromium and Selenium from Debian; SimpleITK and surface-distance from PyPI into build/references,
                      whose Python the tests then use. Without them those tests are skipped, and say so.
  --check             install nothing; name the missing packages and exit 1 if there are any
  --list              print the names of all packages and exit
EOF
}

packages=(
  build-essential cmake ninja-build ccache                            # compiler and build
  libtbb-dev libeigen3-dev libnanoflann-dev                           # solver
  libcli11-dev libtomlplusplus-dev nlohmann-json3-dev zlib1g-dev      # command line, settings, results
  libinsighttoolkit5-dev                                              # images and rigid registration
  libpng-dev libjpeg-dev                                              # pictures of the report
  libgtest-dev python3 python3-numpy                                  # tests; Python for the verification cases only
  python3-meshio                                                      # scripts/mesh_to_case.py and its test
)

reference_packages=(
  python3-scipy python3-skimage python3-matplotlib python3-venv       # tests/evaluate_reference_test.py, scripts/compare.py
  chromium chromium-driver python3-selenium python3-pil               # tests/report_page_test.py: report.html in a browser
)
pypi_packages=(SimpleITK surface-distance)                            # tests/evaluate_reference_test.py; not in Debian 12
references="$(dirname "$0")/../build/references"

mode=install with_references=no
while [[ $# -gt 0 ]]; do
  case "$1" in
    --with-references) with_references=yes; packages+=("${reference_packages[@]}") ;;
    --check) mode=check ;;
    --list) mode=list ;;
    -h|--help) usage; exit 0 ;;
    *) usage >&2; exit 2 ;;
  esac
  shift
done
[[ $mode != list ]] || { printf '%s\n' "${packages[@]}"; exit 0; }

stop() { printf 'install_dependencies: %s\n' "$*" >&2; exit 1; }

if ! command -v dpkg-query >/dev/null || ! command -v apt-get >/dev/null; then
  stop "this is not a Debian-like system (no apt-get). Install the equivalents of these packages, then run
scripts/build.sh --no-install: ${packages[*]}"
fi

missing=()
for package in "${packages[@]}"; do
  status=$(dpkg-query --show --showformat='${db:Status-Status}' "$package" 2>/dev/null || true)
  [[ $status == installed ]] || { [[ $package == python3-numpy ]] && python3 -c 'import numpy' 2>/dev/null; } || missing+=("$package")
done

# A Python that sees Debian's packages and, beside them, those of PyPI.
install_references() {
  [[ $with_references == yes && $mode == install ]] || return 0
  if "$references/bin/python3" -c 'import SimpleITK, surface_distance' 2>/dev/null; then return 0; fi
  /usr/bin/python3 -m venv --system-site-packages "$references"
  "$references/bin/python3" -m pip install --disable-pip-version-check "${pypi_packages[@]}" ||
    stop "pip failed. Is this machine offline? Missing from PyPI: ${pypi_packages[*]}"
}
[[ ${#missing[@]} -gt 0 ]] || { install_references; echo "all ${#packages[@]} packages are installed"; exit 0; }
echo "missing: ${missing[*]}"
[[ $mode == install ]] || exit 1

as_root=()
if [[ $(id -u) -ne 0 ]]; then
  command -v sudo >/dev/null || stop "not root and no sudo. As root: apt-get install ${missing[*]}"
  as_root=(sudo)
fi
install_missing() {
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends "${missing[@]}"
}
# The package lists of a fresh machine are often empty or old: fetch them, and go on with the old ones if that fails.
"${as_root[@]}" apt-get update || echo "install_dependencies: the package lists could not be fetched; trying with those at hand" >&2
install_missing || stop "apt-get failed. Is this machine offline, or its Debian older than 12? Missing: ${missing[*]}"
install_references
