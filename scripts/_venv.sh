# Sourced by the other scripts: makes .venv in the repository's root and installs accelsurf into it.
# Needs Python 3.11 or newer, with its venv module; nothing else.

ROOT="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)"
VENV="$ROOT/.venv"
# Versions that CI has tested, and what they are for: wheels differ from one Python and system to another.
CONSTRAINTS="$ROOT/constraints.txt"
MADE_FOR='import platform as p; print("Python", ".".join(p.python_version_tuple()[:2]), "on", p.system(), p.machine())'

say() { printf '\n== %s\n' "$*" >&2; }

find_python() {
    local candidate
    for candidate in ${PYTHON:+"$PYTHON"} python3 python3.13 python3.12 python3.11 python; do
        if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; then
            echo "$candidate"
            return
        fi
    done
    echo "error: no Python 3.11 or newer was found" >&2
    echo "hint: install one, or name it: PYTHON=/path/to/python3 $0" >&2
    exit 1
}

# versions: sets PINS, the options of pip that hold it to the versions of constraints.txt; none where they are not for
# this Python and system: there pip takes the newest versions that pyproject.toml allows.
versions() {
    local here made
    here="$("$VENV/bin/python" -c "$MADE_FOR")"
    made="$(sed -n 's/^# Made for: //p' "$CONSTRAINTS")"
    PINS=(--constraint "$CONSTRAINTS")
    if [[ "$here" != "$made" ]]; then
        say "Versions are the newest that pyproject.toml allows: constraints.txt is for $made, this is $here"
        PINS=()
    fi
}

# prepare EXTRA: EXTRA is "" for what people need to run accelsurf, "dev" for the tools of its tests.
prepare() {
    local extra="$1" stamp want python
    if ! "$VENV/bin/python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; then
        python="$(find_python)"
        say "Making $VENV with $("$python" --version)"
        if ! "$python" -m venv --clear "$VENV"; then
            echo "error: $python could not make a virtual environment" >&2
            echo "hint: on Debian and Ubuntu: apt install python3-venv" >&2
            exit 1
        fi
    fi
    # What was installed is recorded, so that a second run installs nothing: the folder, Python, and what names versions.
    want="$("$VENV/bin/python" - "$ROOT" <<'PY'
import hashlib, pathlib, sys
said = b"".join(pathlib.Path(sys.argv[1], name).read_bytes() for name in ("pyproject.toml", "constraints.txt"))
print(sys.argv[1], sys.version.split()[0], hashlib.sha256(said).hexdigest())
PY
)"
    # An environment with the development tools serves the demo too.
    for stamp in "$VENV/.accelsurf-dev" "$VENV/.accelsurf-${extra:-run}"; do
        if [[ -f "$stamp" && "$(cat "$stamp")" == "$want" ]]; then
            say "Using $VENV (already installed)"
            return
        fi
    done
    say "Installing accelsurf${extra:+ and its $extra tools} into $VENV (the first time takes some minutes)"
    rm -f "$VENV/.accelsurf-dev" "$VENV/.accelsurf-run"
    versions
    "$VENV/bin/python" -m pip install --quiet --disable-pip-version-check "${PINS[@]}" --editable "$ROOT${extra:+[$extra]}"
    printf '%s\n' "$want" >"$stamp"
}

# prepare_each EXTRA: what the extra lists, one by one: what does not build or has no wheel here is told and left out.
prepare_each() {
    local extra="$1" stamp="$VENV/.accelsurf-each-$1" want requirement
    want="$(cksum "$ROOT/pyproject.toml" "$CONSTRAINTS") $("$VENV/bin/python" -c 'import sys; print(sys.version.split()[0])')"
    [[ -f "$stamp" && "$(cat "$stamp")" == "$want" ]] && return
    say "Installing the $extra tools into $VENV, one by one"
    versions
    while read -r requirement; do
        "$VENV/bin/python" -m pip install --quiet --disable-pip-version-check "${PINS[@]}" "$requirement" ||
            echo "warning: $requirement could not be installed; what needs it will be skipped" >&2
    done < <("$VENV/bin/python" - "$ROOT" "$extra" <<'PY'
import pathlib, sys, tomllib
project = tomllib.loads(pathlib.Path(sys.argv[1], "pyproject.toml").read_text())["project"]
print(*project["optional-dependencies"][sys.argv[2]], sep="\n")
PY
)
    printf '%s\n' "$want" >"$stamp"
}
