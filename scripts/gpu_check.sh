#!/usr/bin/env bash
# Everything that only a machine with a GPU can tell, in one go: tests, memory checks, throughput.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)

usage() {
  cat <<'EOT'
usage: scripts/gpu_check.sh [--output DIR] [--binaries DIR] [-DNAME=VALUE ...]

Builds with the CMake preset `gpu` (no ITK needed), then runs the tests that need a GPU, the same under compute-sanitizer
(memcheck, racecheck, initcheck; without the cases with "Large" in their name), and the benchmark step_perf. What ran, how
long, and how it ended goes to DIR/gpu_check.json, the output of each step to DIR/NAME.log.

  --output DIR     default: output/gpu_check
  --binaries DIR   use the programs in DIR (such as build/bin of another machine) instead of building
  -DNAME=VALUE     passed to CMake, such as -DCMAKE_CUDA_ARCHITECTURES=native for other GPUs than Hopper

Environment: MTLED_STEP_SECONDS, the longest time of one step (600).
Exit code: 0 all passed or were skipped for a reason in the JSON, 1 something failed, 77 there is no GPU: then the build is
tested, and that the tests say that they are skipped.
EOT
}

output=$root/output/gpu_check binaries="" cmake_arguments=()
while [[ $# -gt 0 ]]; do
  case "$1" in
    -h|--help) usage; exit 0 ;;
    --output) output=${2:?--output needs a folder}; shift ;;
    --binaries) binaries=$(cd "${2:?--binaries needs a folder}" && pwd); shift ;;
    -D*) cmake_arguments+=("$1") ;;
    *) echo "gpu_check: unknown option '$1'" >&2; usage >&2; exit 2 ;;
  esac
  shift
done
mkdir -p "$output"
output=$(cd "$output" && pwd)
cd "$root"
limit=${MTLED_STEP_SECONDS:-600}
needs_device='*OnCuda.*:*/*cuda'

# A JSON text of the argument.
text() { printf '"%s"' "$(printf '%s' "$1" | tr -d '\000-\010\013\014\016-\037' | tr '\t\r\n' '   ' | sed 's/\\/\\\\/g; s/"/\\"/g')"; }

steps="" failed=no
# record NAME STATUS EXIT_CODE SECONDS COMMAND REASON
record() {
  steps+="${steps:+,}
  {\"name\": $(text "$1"), \"status\": \"$2\", \"exit_code\": $3, \"seconds\": $4, \"command\": $(text "$5"), \"reason\": $(text "$6")}"
  printf '%-28s %s%s\n' "$1" "$2" "${6:+ ($6)}"
  [[ $2 != failed ]] || failed=yes
}
skip() { record "$1" skipped null 0 "" "$2"; }
# run NAME COMMAND...: its output goes to NAME.log. A test that is skipped though there is a GPU has failed.
run() {
  local name=$1 started=$SECONDS code=0 reason=""
  shift
  timeout --kill-after=20 "$limit" "$@" > "$output/$name.log" 2>&1 || code=$?
  local seconds=$((SECONDS - started))
  if [[ $code -eq 124 ]]; then reason="took more than $limit s"
  elif [[ $code -ne 0 ]]; then reason="see $name.log"
  elif [[ $gpu == yes ]] && grep -q 'SKIPPED: ' "$output/$name.log"; then reason="tests were skipped: $(sed -n 's/.*\(SKIPPED: .*\)/\1/p' "$output/$name.log" | head -n 1)"; fi
  record "$name" "$([[ -z $reason ]] && echo passed || echo failed)" "$code" "$seconds" "$*" "$reason"
  [[ -z $reason ]]
}

started_at=$(date --utc +%FT%TZ) gpu=no finished=no
# Written at the end, and also when the script stops early.
write_report() {
  local result=passed
  if [[ $failed == yes || $finished == no ]]; then result=failed; elif [[ $gpu == no ]]; then result="no GPU"; fi
  cat > "$output/gpu_check.json.tmp" <<EOT
{
 "result": "$result",
 "started": "$started_at",
 "commit": $(text "$(git describe --always --dirty --exclude '*' 2>/dev/null || echo unknown)"),
 "gpus": $(text "$(nvidia-smi --query-gpu=name,memory.total,driver_version --format=csv,noheader 2>/dev/null | paste -sd ';' || true)"),
 "info": $(text "$(if [[ -x ${binaries:-none}/mtled ]]; then "$binaries/mtled" info 2>&1 | paste -sd ';'; fi)"),
 "nvcc": $(text "$(PATH=$PATH:/usr/local/cuda/bin nvcc --version 2>/dev/null | tail -n 1 || true)"),
 "binaries": $(text "$binaries"),
 "steps": [$steps
 ]
}
EOT
  mv "$output/gpu_check.json.tmp" "$output/gpu_check.json"
  echo "report: $output/gpu_check.json ($result)"
}
trap write_report EXIT

if [[ -n $binaries ]]; then
  skip build "programs of $binaries are used"
else
  generator=()
  if [[ ! -f build-gpu/CMakeCache.txt ]] && command -v ninja >/dev/null; then generator=(-G Ninja); fi
  run configure cmake --preset gpu "${generator[@]}" "${cmake_arguments[@]}" || exit 1
  limit=$((3 * limit)) run build cmake --build build-gpu --parallel "$(nproc)" || exit 1
  binaries=$root/build-gpu/bin
fi

if [[ ! -x $binaries/mtled ]]; then
  record info failed null 0 "$binaries/mtled info" "there is no $binaries/mtled"
  exit 1
fi
# The program itself knows best: a line such as "cuda:0: NVIDIA H100, ..." for every device.
run info "$binaries/mtled" info || exit 1
if grep -q '^cuda:[0-9]*: ' "$output/info.log"; then gpu=yes; fi
reason="no GPU: $(grep -m 1 '^CUDA cannot be used\|^CUDA: not in' "$output/info.log" || echo "see info.log")"
[[ $gpu == yes ]] || echo "$reason"

tests=()
for program in "$binaries"/*_test; do
  if "$program" --gtest_list_tests --gtest_filter="$needs_device" 2>/dev/null | grep -q "^  "; then tests+=("$program"); fi
done
[[ ${#tests[@]} -gt 0 ]] || record tests failed null 0 "$binaries/*_test --gtest_filter=$needs_device" "no program there has tests that need a GPU"

for program in "${tests[@]}"; do
  name=$(basename "$program")
  if [[ $gpu == yes ]]; then
    run "$name" "$program" --gtest_filter="$needs_device" || true
  else
    run "rehearse_$name" "$program" --gtest_filter="$needs_device" || true
    if grep -q 'SKIPPED: ' "$output/rehearse_$name.log" && ! grep -q '\[       OK \]' "$output/rehearse_$name.log"; then skip "$name" "$reason"
    else record "$name" failed null 0 "$program" "it does not say that it was skipped, though there is no GPU"; fi
  fi
done

sanitizer=$(PATH=$PATH:/usr/local/cuda/bin command -v compute-sanitizer || true)
for tool in memcheck racecheck initcheck; do
  for program in "${tests[@]}"; do
    name=${tool}_$(basename "$program")
    if [[ -z $sanitizer ]]; then skip "$name" "no compute-sanitizer in PATH or /usr/local/cuda/bin"
    elif [[ $gpu == no ]]; then skip "$name" "$reason"
    else
      more=()
      if [[ $tool == memcheck ]]; then more=(--leak-check full); fi
      run "$name" "$sanitizer" --tool "$tool" "${more[@]}" --error-exitcode 99 "$program" --gtest_filter="$needs_device:-*Large*" || true
    fi
  done
done

if [[ ! -x $binaries/step_perf ]]; then skip step_perf "there is no $binaries/step_perf"
elif [[ $gpu == no ]]; then skip step_perf "$reason"
else run step_perf "$binaries/step_perf" --output "$output/step_perf" || true; fi

finished=yes
if [[ $failed == yes ]]; then exit 1; fi
if [[ $gpu == no ]]; then exit 77; fi
