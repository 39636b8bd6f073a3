#!/usr/bin/env bash
# Registers, spills and shared memory of every kernel, as the assembler reports them.
set -euo pipefail
cd "$(dirname "$0")/.."

usage() {
  cat <<'EOT'
usage: scripts/kernel_resources.sh [--architecture N] [--output FILE]

Compiles the CUDA backend for one compute capability (default: 90) with the assembler's report on (ptxas -v) and writes a
Markdown table of all kernels to FILE (default: perf/results/kernels.md). Needs nvcc and make, but no GPU.
EOT
}

architecture=90 output=perf/results/kernels.md
while [[ $# -gt 0 ]]; do
  case "$1" in
    -h|--help) usage; exit 0 ;;
    --architecture) architecture=${2:?--architecture needs a number}; shift ;;
    --output) output=${2:?--output needs a file}; shift ;;
    *) echo "kernel_resources: unknown option '$1'" >&2; usage >&2; exit 2 ;;
  esac
  shift
done

build=$PWD/build-kernels
cmake --preset ci -G "Unix Makefiles" -B "$build" -DMTLED_IMAGING=OFF -DMTLED_TESTS=OFF -DCMAKE_CUDA_ARCHITECTURES="$architecture-real" -DCMAKE_CUDA_FLAGS=-Xptxas=-v \
  -DCMAKE_CUDA_COMPILER_LAUNCHER= > "$build.log" 2>&1 || { cat "$build.log" >&2; exit 1; }
rm "$build.log"
report=$build/ptxas.log
# Only what has kernels, and all of it again: there is no report of what need not be compiled.
find "$build/src/cuda" -name '*.cu.o' -delete
objects=(src/cuda/*.cu)
objects=("${objects[@]/#src\/cuda\//}")
make -C "$build/src/cuda" "${objects[@]/%/.o}" > "$report" 2>&1 || { cat "$report" >&2; exit 1; }

rows=$(awk '
  /Compiling entry function/ { split($0, part, "\x27"); name = part[2] }
  /bytes stack frame/        { stack = $1 + 0; stores = $5 + 0; loads = $9 + 0 }
  /Used [0-9]+ registers/    {
    registers = shared = 0
    for (i = 1; i < NF; ++i) {
      if ($(i + 1) ~ /^registers/) registers = $i
      if ($(i + 1) == "bytes" && $(i + 2) ~ /^smem/) shared = $i
    }
    print name, registers, stack, stores, loads, shared
  }' "$report" | sort -k 1,1)
[[ -n $rows ]] || { echo "kernel_resources: the assembler reported no kernel; see $report" >&2; exit 1; }
mkdir -p "$(dirname "$output")"
{
  nvcc=$(sed -n 's/^CMAKE_CUDA_COMPILER:[^=]*=//p' "$build/CMakeCache.txt")
  echo "# Resources of the kernels"
  echo
  flags=$(sed -n 's/^CUDA_FLAGS = //p' "$build/src/cuda/CMakeFiles/mtled_cuda.dir/flags.make")
  echo "Compute capability $((architecture / 10)).$((architecture % 10)), nvcc $("$nvcc" --version | sed -n 's/.*release.*V\([0-9.]*\).*/\1/p'), commit $(git describe --always --dirty --exclude '*')." \
    "Written by \`scripts/kernel_resources.sh\`. Per thread: registers, and bytes of stack and of spilled registers; per block: bytes of static shared memory." \
    "Flags: \`$flags\`; for field.cu also \`-fmad=false\`."
  echo
  echo "| kernel | registers | stack | spill stores | spill loads | shared memory |"
  echo "|---|---|---|---|---|---|"
  # shellcheck disable=SC2016
  c++filt --no-params <<< "$rows" | sed 's/mtled:://g; s/|/\\|/g; s/^\(.*\) \([0-9]*\) \([0-9]*\) \([0-9]*\) \([0-9]*\) \([0-9]*\)$/| `\1` | \2 | \3 | \4 | \5 | \6 |/'
} > "$output.tmp"
mv "$output.tmp" "$output"
echo "written: $output ($(wc -l <<< "$rows") kernels)"
