"""Drives the rig. Downbeat writes one line for each command, and this program answers with one line.

Replace `set_value` with the calls of your hardware's library. The protocol is described in docs/edge.md.
"""

import sys
import time


def set_value(device, value):
    """Sets one device. Must return within a second, and should return within milliseconds."""
    with open("driven.txt", "a", encoding="utf-8") as log:
        log.write(f"{time.time():.6f} {device} {value}\n")


for line in sys.stdin:
    verb, *words = line.split()
    if verb == "set":
        device, _control_type, value = words
        set_value(device, float(value))
        print("ok", flush=True)
    elif verb == "read":
        print("error no sensor is connected", flush=True)
    else:  # `hello` and `ping`
        print("ok", flush=True)
