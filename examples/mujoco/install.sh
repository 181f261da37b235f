#!/bin/sh
# Installs the requirements of this example into a virtual environment: install.sh [FOLDER], by default `venv` in this folder.
set -eu
here="$(cd "$(dirname "$0")" && pwd)"
venv="${1:-$here/venv}"
python3 -m venv "$venv"
"$venv/bin/pip" install --quiet mujoco==4.0.0 numpy "$here/../../robot/drivers/python"
# Only the models of these two packages are used, so their dependencies are not needed.
"$venv/bin/pip" install --quiet --no-deps robosuite==1.5.2 robosuite_models==1.0.0
