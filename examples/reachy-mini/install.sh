#!/bin/sh
# Installs the requirements of this example into a virtual environment: install.sh [FOLDER], by default `venv` in this folder.
# The maker's daemon uses GStreamer through PyGObject, even without a camera. These packages come from Debian:
#   apt install python3-venv python3-gi python3-cairo gir1.2-gstreamer-1.0 gir1.2-gst-plugins-base-1.0
set -eu
here="$(cd "$(dirname "$0")" && pwd)"
venv="${1:-$here/venv}"
# Debian's own Python, because only this one has Debian's PyGObject.
/usr/bin/python3 -m venv --system-site-packages "$venv"
"$venv/bin/pip" install --quiet 'reachy-mini[mujoco]==1.12.0' "$here/../../robot/drivers/python"
