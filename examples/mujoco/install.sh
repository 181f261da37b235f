#!/bin/sh
# Installs what this example needs into a virtual environment: install.sh [FOLDER], which is `venv` here without an argument.
set -eu
here="$(cd "$(dirname "$0")" && pwd)"
venv="${1:-$here/venv}"
python3 -m venv "$venv"
"$venv/bin/pip" install --quiet mujoco==4.0.0 numpy "$here/../../robot/drivers/python"
# Of these two only the models are used, so nothing that they depend on is needed.
"$venv/bin/pip" install --quiet --no-deps robosuite==1.5.2 robosuite_models==1.0.0
