#!/usr/bin/env bash
# Builds everything and runs all tests.
set -euo pipefail
cd "$(dirname "$0")/.."

usage() {
  cat <<'EOF'
usage: scripts/test.sh [build options] [-- ctest options]

Builds (see scripts/build.sh --help for its options) and runs all tests with CTest; shows the output of those that fail.
Examples: scripts/test.sh -- -R warp              only tests with "warp" in their name
          scripts/test.sh -- -L verification      only the comparison with the reference solutions

Tests that need large data which the repository does not hold are skipped, and say so, unless the environment variable
MTLED_SHARED_DATA names the folder that has them. So are tests that compare mtled with other programs or open its report
in a browser, unless scripts/install_dependencies.sh --with-references has installed these.
EOF
}

build_options=()
while [[ $# -gt 0 ]]; do
  case "$1" in
    -h|--help) usage; exit 0 ;;
    --) shift; break ;;
    *) build_options+=("$1"); shift ;;
  esac
done

scripts/build.sh "${build_options[@]}"

# The tests are multi-threaded themselves: a few at a time are enough.
parallel=$(( $(nproc) < 4 ? $(nproc) : 4 ))
started=$SECONDS status=0
ctest --test-dir build --output-on-failure --no-tests=error --parallel "$parallel" "$@" || status=$?
# CTest names what was skipped, but not why.
sed -n 's/.*\(SKIPPED: .*\)/\1/p' build/Testing/Temporary/LastTest.log | sort | uniq -c
count=$(ctest --test-dir build --show-only "$@" | awk '/^Total Tests:/ {print $3}')
if [[ $status -eq 0 ]]; then
  echo "$count tests passed or were skipped (skipped ones are named above) in $((SECONDS - started)) s"
else
  echo "some of $count tests failed (named above)" >&2
fi
exit "$status"
