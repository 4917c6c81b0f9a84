#!/usr/bin/env bash
# Builds build/site from the pages as they lie in the tree, with what they link to; a warning is an error.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
if [ ! -x .venv-docs/bin/mkdocs ]; then
  echo "docs: installing mkdocs-material into .venv-docs"
  "${PYTHON:-python3}" -m venv .venv-docs
  .venv-docs/bin/python -m pip install --quiet --disable-pip-version-check -r requirements-docs.txt
fi
rm -rf build/docs
mkdir -p build/docs && touch build/COLCON_IGNORE
git ls-files -z -- '*.md' docs examples msg_defs tests/data elastic_arm/robot/data LICENSE |
  xargs -0 cp --parents --no-dereference --target-directory build/docs
NO_MKDOCS_2_WARNING=1 .venv-docs/bin/mkdocs build --strict 2>&1 | sed '/^INFO/d; /^  - /d; /^$/d'
echo "docs: build/site/index.html"
