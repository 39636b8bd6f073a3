#!/usr/bin/env bash
# Builds everything; the program is then build/bin/mtled.
set -euo pipefail
cd "$(dirname "$0")/.."

usage() {
  cat <<'EOF'
usage: scripts/build.sh [options] [-DNAME=VALUE ...]

Installs missing packages, configures and builds mtled and its tests in build/. The program is build/bin/mtled.

  --build-type TYPE   Release (default), RelWithDebInfo or Debug
  --target NAME       build only this, e.g. mtled
  --jobs N            compile N files at a time (default: as many as processors and free memory allow)
  --no-install        do not look for missing packages
  -DNAME=VALUE        passed to CMake, e.g. -DMTLED_IMAGING=OFF (no ITK: `mtled solve` only), -DMTLED_TESTS=OFF,
                      -DMTLED_CUDA=OFF or ON (default: AUTO, with CUDA where its compiler is found),
                      -DCMAKE_CUDA_ARCHITECTURES=native (for the GPU of this machine)
EOF
}

build_type=Release target=all jobs="" install=yes cmake_arguments=()
while [[ $# -gt 0 ]]; do
  case "$1" in
    --build-type) build_type=${2:?--build-type needs a value}; shift ;;
    --target) target=${2:?--target needs a name}; shift ;;
    --jobs) jobs=${2:?--jobs needs a number}; shift ;;
    --no-install) install=no ;;
    -D*) cmake_arguments+=("$1") ;;
    -h|--help) usage; exit 0 ;;
    *) echo "build: unknown option '$1'" >&2; usage >&2; exit 2 ;;
  esac
  shift
done

# A file that uses ITK takes about 1 GB to compile.
memory_per_job_kb=1200000
jobs_that_fit() {
  local free processors fit
  free=$(awk '/^MemAvailable:/ {print $2}' /proc/meminfo)
  if [[ -r /sys/fs/cgroup/memory.max && $(< /sys/fs/cgroup/memory.max) != max ]]; then
    local limit=$(( ($(< /sys/fs/cgroup/memory.max) - $(< /sys/fs/cgroup/memory.current)) / 1024 ))
    (( limit < free )) && free=$limit
  fi
  processors=$(nproc)
  fit=$(( free / memory_per_job_kb ))
  (( fit > processors )) && fit=$processors
  (( fit < 1 )) && fit=1
  echo "$fit"
}
[[ -n $jobs ]] || jobs=$(jobs_that_fit)

[[ $install == no ]] || scripts/install_dependencies.sh

if [[ ! -f build/CMakeCache.txt ]]; then
  if command -v ninja >/dev/null; then cmake_arguments+=(-G Ninja); fi
  if command -v ccache >/dev/null; then cmake_arguments+=(-DCMAKE_CXX_COMPILER_LAUNCHER=ccache -DCMAKE_CUDA_COMPILER_LAUNCHER=ccache); fi
fi
cmake -S . -B build -DCMAKE_BUILD_TYPE="$build_type" "${cmake_arguments[@]}"
echo "building with $jobs job(s)"
cmake --build build --parallel "$jobs" --target "$target"
echo "built: build/bin/mtled"
