#!/bin/sh
# Installs what this example needs into a virtual environment: install.sh [FOLDER], which is `venv` here without an argument.
# The maker's daemon uses GStreamer through PyGObject, also without a camera. These come from Debian:
#   apt install python3-venv python3-gi python3-cairo gir1.2-gstreamer-1.0 gir1.2-gst-plugins-base-1.0
set -eu
here="$(cd "$(dirname "$0")" && pwd)"
venv="${1:-$here/venv}"
# Debian's own Python, because only that one has Debian's PyGObject.
/usr/bin/python3 -m venv --system-site-packages "$venv"
"$venv/bin/pip" install --quiet 'reachy-mini[mujoco]==1.12.0' "$here/../../robot/drivers/python"
