#!/usr/bin/env python3
"""Does `downbeat discover` find what answers on a network? The network has Open Lighting Architecture (`olad`) as an Art-Net node,
and a robot. They run on a machine (a network namespace) of their own. Needs root and the Debian package ola.

Prints what was found. Exits 1 if anything of it is missing.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from downbeat_lab import program
from downbeat_lab.machines import machines, on
from downbeat_lab.processes import Processes
from lights import ARTNET, DESK, LIGHTS, LIGHTS_ADDRESS, MACHINES, network, start_olad

ROBOT = """id: arm
api_version: '1'
devices:
  - id: elbow
    available_control_types:
      position: {min_value: 0, max_value: 90, granularity: 1}
"""


def main():
    options = program.arguments(__doc__).parse_args()
    downbeat = program.find_downbeat(options.downbeat)
    with tempfile.TemporaryDirectory() as folder, machines(MACHINES), Processes() as processes:
        folder = Path(folder)
        folder.chmod(0o755)
        (folder / "olad").mkdir()
        network()
        start_olad(folder / "olad", processes)
        (folder / "robot.yaml").write_text(ROBOT)
        listen = ("--listen", "0.0.0.0:7401", "--insecure")
        processes.start_listening(*on(LIGHTS, downbeat, "robot", "--init", "robot.yaml", *listen), robots=1, cwd=folder)
        found = subprocess.run(on(DESK, downbeat, "discover", "--interface", "eth0", "--format", "json"), capture_output=True, text=True, check=True)
    found = json.loads(found.stdout)
    print(json.dumps(found, indent=2))
    expected = {
        "a robot": any(robot["address"] == f"tcp://{LIGHTS_ADDRESS}:7401" and robot["block"] for robot in found["robots"]),
        "an Art-Net node": any(node["address"] == LIGHTS_ADDRESS and ARTNET in node["universes"] for node in found["art_net"]),
    }
    missing = [what for what, is_found in expected.items() if not is_found]
    if missing:
        sys.exit(f"not found: {', '.join(missing)}")


if __name__ == "__main__":
    main()
