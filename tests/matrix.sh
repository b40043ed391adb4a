#!/usr/bin/env bash
# A share of the tests with the oldest and the newest versions that pyproject.toml allows, on every
# Python of 3.11 to 3.14 that is installed. PYTHONS names interpreters that are not on the path.
set -euo pipefail
cd "$(dirname "$0")/.."

share=(tests/numerics tests/solvers tests/plus tests/settings tests/config tests/session/test_live.py
  tests/sources tests/files tests/outputs tests/masks tests/detectors tests/backbone/test_vit.py)
pythons=(${PYTHONS:-$(for minor in 11 12 13 14; do command -v "python3.$minor" || true; done)})
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT

failed=()
for python in "${pythons[@]}"; do
  "$python" -c '' 2>/dev/null || continue
  for resolution in lowest-direct highest; do
    name="$("$python" --version) with $resolution versions"
    echo "== $name"
    environment="$place/environment"
    rm -rf "$environment"
    "$UV" venv --quiet --python "$python" "$environment"
    # The oldest versions with wheels for this Python: older ones would be built from source.
    if VIRTUAL_ENV="$environment" "$UV" pip install --quiet --resolution "$resolution" \
      --only-binary :all: -e ".[dev,detect]" && "$environment/bin/python" -m pytest -q -n 2 \
      -m "not slow and not heavy" "${share[@]}"
    then echo "== $name: passed"; else failed+=("$name"); fi
  done
done
((${#failed[@]} == 0)) || { printf '== failed: %s\n' "${failed[@]}"; exit 1; }
