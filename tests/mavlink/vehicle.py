#!/usr/bin/env python3
"""A multicopter for tests: pymavlink sends heartbeats to the port given as the first argument, acknowledges commands, and follows positions.

Prints each message that it receives as a line of JSON with its time in nanoseconds. Refuses the commands whose numbers follow the port.
"""

import json
import sys
import time

from pymavlink import mavutil
from pymavlink.dialects.v20 import common

PORT, REFUSED = sys.argv[1], [int(number) for number in sys.argv[2:]]
POSITION_S = 0.05


def main():
    link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{PORT}", source_system=7, source_component=1, dialect="common")
    place = {"x": 0.0, "y": 0.0, "z": 0.0, "yaw": 0.0}
    armed, next_heartbeat, next_position = False, 0.0, 0.0
    while True:
        now = time.monotonic()
        if now >= next_heartbeat:
            next_heartbeat = now + 1.0
            mode = common.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
            link.mav.heartbeat_send(common.MAV_TYPE_QUADROTOR, common.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, 4, common.MAV_STATE_ACTIVE)
        if now >= next_position:
            next_position = now + POSITION_S
            link.mav.local_position_ned_send(int(now * 1000) & 0xFFFFFFFF, place["x"], place["y"], place["z"], 0, 0, 0)
        message = link.recv_match(blocking=True, timeout=POSITION_S)
        if message is None or message.get_type() == "BAD_DATA":
            continue
        print(json.dumps({"at": time.time_ns(), "type": message.get_type(), **message.to_dict()}, allow_nan=True), flush=True)
        if message.get_type() == "COMMAND_LONG":
            refused = message.command in REFUSED
            link.mav.command_ack_send(message.command, common.MAV_RESULT_DENIED if refused else common.MAV_RESULT_ACCEPTED)
            if message.command == common.MAV_CMD_COMPONENT_ARM_DISARM and not refused:
                armed = message.param1 == 1
            if message.command == common.MAV_CMD_NAV_TAKEOFF and not refused:
                place["z"] = -message.param7
        if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
            place = {key: getattr(message, key) for key in place}


if __name__ == "__main__":
    main()
