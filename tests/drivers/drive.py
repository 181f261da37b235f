"""Drives by writing values to the file argv[1]; in their place would stand a GPIO library."""

import sys

with open(sys.argv[1], "a", buffering=1) as driven:
    for line in sys.stdin:
        verb, *words = line.split()
        if verb == "set":
            device, control_type, value = words
            driven.write(f"{device} {control_type} {value}\n")
            print("ok", flush=True)
        elif verb == "read":
            print("error no sensor is connected", flush=True)
        else:  # hello, ping
            print("ok", flush=True)
