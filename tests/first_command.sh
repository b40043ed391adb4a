#!/usr/bin/env bash
# The demo and the README's live loop, as a newcomer meets them: the wheel alone, in an empty folder,
# on the oldest Python with the oldest versions that pyproject.toml allows, and on the newest Python
# at hand with the newest versions of that day. PYTHONS names interpreters, the oldest first.
set -euo pipefail
cd "$(dirname "$0")/.."

find_pythons() {
  for minor in 11 12 13 14; do
    "python3.$minor" -c '' 2>/dev/null && command -v "python3.$minor" && continue
    compgen -G "${PYENV_ROOT:-$HOME/.pyenv}/versions/3.$minor.*/bin/python" | tail -n 1 || continue
  done
}

pythons=(${PYTHONS:-$(find_pythons)})
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
"$UV" build --quiet --wheel --out-dir "$place" .
# The block of the README that makes a `Tracker`.
awk '/^```python/ {block = ""; inside = 1; next}
  /^```/ {if (inside && block ~ /tracker\.update/) printf "%s", block; inside = 0}
  inside {block = block $0 "\n"}' README.md >"$place/live.py"
test -s "$place/live.py"

try() { # interpreter, resolution
  local name environment="$place/$2" folder="$place/folder-$2"
  name="$("$1" --version) with $2 versions"
  "$UV" venv --quiet --python "$1" "$environment"
  VIRTUAL_ENV="$environment" "$UV" pip install --quiet --resolution "$2" --only-binary :all: \
    "$place"/*.whl
  mkdir "$folder"
  cd "$folder"
  export REMIND_PROGRAMS="$place/programs-$2"
  "$environment/bin/remind" demo --json >summary.json
  "$environment/bin/python" - "$name" <<'PYTHON'
import json, sys
import jax

idf1 = json.load(open("summary.json"))["metrics"]["IDF1"]
print(f"demo on {sys.argv[1]}, jax {jax.__version__}: IDF1 {idf1:.3f}")
sys.exit(idf1 < 0.97)
PYTHON
  "$environment/bin/python" "$place/live.py" >/dev/null
  cd - >/dev/null
}

try "${pythons[0]}" lowest-direct
try "${pythons[-1]}" highest
