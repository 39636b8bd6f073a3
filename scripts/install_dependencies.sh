#!/usr/bin/env bash
# Installs what mtled needs to be built and tested on Debian 12 and its relatives.
set -euo pipefail

usage() {
  cat <<'EOF'
usage: scripts/install_dependencies.sh [--check | --list]

Installs the Debian packages that mtled needs and that are not there yet (apt-get, with sudo when not root).
Does nothing, and needs no network, when all are there.

  --check   install nothing; name the missing packages and exit 1 if there are any
  --list    print the names of all packages and exit
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

mode=install
case "${1:-}" in
  "") ;;
  --check) mode=check ;;
  --list) printf '%s\n' "${packages[@]}"; exit 0 ;;
  -h|--help) usage; exit 0 ;;
  *) usage >&2; exit 2 ;;
esac

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
[[ ${#missing[@]} -gt 0 ]] || { echo "all ${#packages[@]} packages are installed"; exit 0; }
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
