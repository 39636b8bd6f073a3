#!/usr/bin/env bash
# Everything that only a machine with a GPU can tell, in one go: tests, memory checks, throughput.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)

usage() {
  cat <<'EOT'
usage: scripts/gpu_check.sh [--output DIR] [--binaries DIR] [--parts LIST] [--case DIR] [-DNAME=VALUE ...]

The parts, one after the other:
  build       with the CMake preset `gpu` (no ITK needed)
  tests       the tests that need a GPU
  case        solves a small case, made here, on the GPU and on the CPU: the displacement of no node may differ by 1e-3 mm or
              more in double precision, and by 0.05 mm, the solver's usual tolerance, in single precision
  memcheck, racecheck, initcheck    the tests under compute-sanitizer, without the cases with "Large" in their name
  speed       the benchmark step_perf, on lattices and on a general cloud
What ran, how long, and how it ended goes to DIR/gpu_check.json after every step, the output of each step to DIR/NAME.log.

  --output DIR     default: output/gpu_check
  --binaries DIR   use the programs in DIR (such as build/bin of another machine) instead of building; shared libraries that
                   this machine lacks (ldd DIR/mtled; libtbb.so.12, libtomlplusplus.so.3 most likely) may lie there
  --parts LIST     only these, with commas between them, such as build,tests: for machines that limit a command's time
  --case DIR       solve DIR/case.toml (such as `mtled register --export-case` writes) instead of the small case
  -DNAME=VALUE     passed to CMake, such as -DCMAKE_CUDA_ARCHITECTURES=native for other GPUs than Hopper

Environment: MTLED_STEP_SECONDS, the longest time of one step (600).
Exit code: 0 all passed or were skipped for a reason in the JSON, 1 something failed, 77 there is no GPU: then the build is
tested, and that the tests say that they are skipped.
EOT
}

output=$root/output/gpu_check binaries="" case="" parts=build,tests,case,memcheck,racecheck,initcheck,speed cmake_arguments=()
while [[ $# -gt 0 ]]; do
  case "$1" in
    -h|--help) usage; exit 0 ;;
    --output) output=${2:?--output needs a folder}; shift ;;
    --binaries) binaries=$(cd "${2:?--binaries needs a folder}" && pwd); shift ;;
    --parts)
      parts=${2:?--parts needs a list}
      for part in ${parts//,/ }; do
        case "$part" in
          build|tests|case|memcheck|racecheck|initcheck|speed) ;;
          *) echo "gpu_check: there is no part '$part'" >&2; usage >&2; exit 2 ;;
        esac
      done
      shift ;;
    --case)
      case=$(cd "${2:?--case needs a folder}" && pwd)
      [[ -f $case/case.toml ]] || { echo "gpu_check: there is no $case/case.toml" >&2; exit 2; }
      shift ;;
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
wants() { [[ ,$parts, == *,$1,* ]]; }

# A JSON text of the argument.
text() { printf '"%s"' "$(printf '%s' "$1" | tr -d '\000-\010\013\014\016-\037' | tr '\t\r\n' '   ' | sed 's/\\/\\\\/g; s/"/\\"/g')"; }

steps="" failed=no
# record NAME STATUS EXIT_CODE SECONDS COMMAND REASON
record() {
  steps+="${steps:+,}
  {\"name\": $(text "$1"), \"status\": \"$2\", \"exit_code\": $3, \"seconds\": $4, \"command\": $(text "$5"), \"reason\": $(text "$6")}"
  printf '%-28s %s%s\n' "$1" "$2" "${6:+ ($6)}"
  [[ $2 != failed ]] || failed=yes
  write_report
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
# Written after every step, so that it is there whenever the script is stopped.
write_report() {
  local result=passed
  if [[ $failed == yes ]]; then result=failed; elif [[ $finished == no ]]; then result=unfinished; elif [[ $gpu == no ]]; then result="no GPU"; fi
  cat > "$output/gpu_check.json.tmp" <<EOT
{
 "result": "$result",
 "started": "$started_at",
 "commit": $(text "$(git describe --always --dirty --exclude '*' 2>/dev/null || echo unknown)"),
 "gpus": $(text "$(nvidia-smi --query-gpu=name,memory.total,driver_version --format=csv,noheader 2>/dev/null | paste -sd ';' || true)"),
 "info": $(text "$(if [[ -x ${binaries:-none}/mtled ]]; then "$binaries/mtled" info 2>&1 | paste -sd ';'; fi)"),
 "nvcc": $(text "$(PATH=$PATH:/usr/local/cuda/bin nvcc --version 2>/dev/null | tail -n 1 || true)"),
 "binaries": $(text "$binaries"),
 "parts": $(text "$parts"),
 "steps": [$steps
 ]
}
EOT
  mv "$output/gpu_check.json.tmp" "$output/gpu_check.json"
}
trap 'write_report; echo "report: $output/gpu_check.json"' EXIT

if [[ -n $binaries ]]; then
  skip build "programs of $binaries are used"
  export LD_LIBRARY_PATH=$binaries${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
elif ! wants build; then
  binaries=$root/build-gpu/bin
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
  wants tests || break
  name=$(basename "$program")
  if [[ $gpu == yes ]]; then
    run "$name" "$program" --gtest_filter="$needs_device" || true
  else
    run "rehearse_$name" "$program" --gtest_filter="$needs_device" || true
    if grep -q 'SKIPPED: ' "$output/rehearse_$name.log" && ! grep -q '\[       OK \]' "$output/rehearse_$name.log"; then skip "$name" "$reason"
    else record "$name" failed null 0 "$program" "it does not say that it was skipped, though there is no GPU"; fi
  fi
done

# A block of 8 x 8 x 16 cells, held at the bottom, pulled and turned by springs in a bone near its top.
make_case() {
  mkdir -p "$1"
  awk -v folder="$1" 'BEGIN {
    h = 5; nx = 8; nz = 16; n = 0
    print "x,y,z" > (folder "/nodes.csv"); print "node,ux,uy,uz" > (folder "/constraints.csv")
    print "x,y,z,volume,shear_modulus_kpa" > (folder "/points.csv"); print "x,y,z,stiffness,ux,uy,uz" > (folder "/springs.csv")
    for (k = 0; k <= nz; ++k) for (j = 0; j <= nx; ++j) for (i = 0; i <= nx; ++i) {
      print h * i "," h * j "," h * k > (folder "/nodes.csv")
      if (k == 0) print n "," 0 "," 0 "," 0 > (folder "/constraints.csv")
      ++n
    }
    for (k = 0; k < nz; ++k) for (j = 0; j < nx; ++j) for (i = 0; i < nx; ++i) for (p = -1; p <= 1; p += 2)
      print h * (i + 0.5 + p / 6) "," h * (j + 0.5 + p / 8) "," h * (k + 0.5 + p / 10) "," h^3 / 2 "," (i < 4 ? 1 : 4) > (folder "/points.csv")
    for (k = 11; k <= 14; ++k) for (j = 3; j <= 5; ++j) for (i = 3; i <= 5; ++i)
      print h * (i + 0.1) "," h * (j + 0.1) "," h * (k + 0.1) ",5000," 4 + 0.2 * h * (j - 4) "," 0.2 * h * (4 - i) ",3" > (folder "/springs.csv")
  }'
  cat > "$1/case.toml" <<'EOT'
[nodes]
file = "nodes.csv"
lattice = { origin = [0.0, 0.0, 0.0], spacing = 5.0 }
[points]
file = "points.csv"
[material]
poisson_ratio = 0.49
[constraints]
file = "constraints.csv"
[springs]
file = "springs.csv"
[solver]
tolerance_mm = 0.001
EOT
}
# largest_difference A B LIMIT: prints the largest difference of a displacement; fails when it is not below LIMIT, or the nodes differ.
largest_difference() {
  paste -d , "$1" "$2" | awk -F , -v limit="$3" '
    NF != 12 || (NR > 1 && ($1 != $7 || $2 != $8 || $3 != $9)) { print "line " NR ": not the same nodes"; bad = 1; exit }
    NR > 1 { for (c = 4; c <= 6; ++c) {
      d = $c - $(c + 6); if (d < 0) d = -d
      if (d > largest) largest = d
      size = $c < 0 ? -$c : $c; if (size > moved) moved = size
    } }
    END {
      if (bad) exit 1
      print "largest difference " largest + 0 " mm at " NR - 1 " nodes, largest displacement " moved + 0 " mm"
      exit !(NR > 1 && moved > 0 && largest < limit)
    }'
}
export -f largest_difference
if wants case; then
  # A copy, to which a case in the other precision is added. Rounding alone moves soft parts in single precision: a corner of
  # the block by 0.02 mm.
  rm -rf "$output/case"
  if [[ -n $case ]]; then cp -r "$case" "$output/case"; else make_case "$output/case"; fi
  sed '/^ *precision *=/d' "$output/case/case.toml" > "$output/case/single.toml"
  grep -q '^\[solver\]' "$output/case/single.toml" || echo '[solver]' >> "$output/case/single.toml"
  sed 's/^\[solver\].*/&\nprecision = "double"/' "$output/case/single.toml" > "$output/case/double.toml"
  for precision in double single; do
    below=$([[ $precision == double ]] && echo 1e-3 || echo 0.05)
    # Without a GPU the comparison itself is rehearsed: one thread and all of them give the same bits.
    if [[ $gpu == yes ]]; then first=(--device cuda); name=case_$precision
    else first=(--device cpu --threads 1); below=1e-12; name=rehearse_case_$precision; fi
    solve=("$binaries/mtled" solve "$output/case/$precision.toml" --force --output)
    if run "${name}_first" "${solve[@]}" "$output/case/${precision}_first" "${first[@]}" && run "${name}_cpu" "${solve[@]}" "$output/case/${precision}_cpu" --device cpu; then
      run "${name}_difference" bash -c 'largest_difference "$@"' largest_difference "$output/case/${precision}_first/nodes.csv" "$output/case/${precision}_cpu/nodes.csv" "$below" || true
      cat "$output/${name}_difference.log"
    fi
  done
  [[ $gpu == yes ]] || skip case "$reason"
fi

sanitizer=$(PATH=$PATH:${CUDA_PATH:-/usr/local/cuda}/bin:/usr/local/cuda/bin:/usr/local/cuda/compute-sanitizer command -v compute-sanitizer || true)
for tool in memcheck racecheck initcheck; do
  wants "$tool" || continue
  for program in "${tests[@]}"; do
    name=${tool}_$(basename "$program")
    if [[ -z $sanitizer ]]; then skip "$name" "no compute-sanitizer in PATH, \$CUDA_PATH/bin or /usr/local/cuda"
    elif [[ $gpu == no ]]; then skip "$name" "$reason"
    else
      more=()
      if [[ $tool == memcheck ]]; then more=(--leak-check full); fi
      run "$name" "$sanitizer" --tool "$tool" "${more[@]}" --error-exitcode 99 "$program" --gtest_filter="$needs_device:-*Large*" || true
    fi
  done
done

if ! wants speed; then :
elif [[ ! -x $binaries/step_perf ]]; then skip step_perf "there is no $binaries/step_perf"
elif [[ $gpu == no ]]; then skip step_perf "$reason"
else
  run step_perf "$binaries/step_perf" --device cuda --output "$output/step_perf" || true
  run step_perf_general "$binaries/step_perf" --device cuda --cloud general --sizes 100000 1000000 --output "$output/step_perf_general" || true
fi

finished=yes
if [[ $failed == yes ]]; then exit 1; fi
if [[ $gpu == no ]]; then exit 77; fi
