"""A ground station at the virtual board's TCP port: parameters, commands, and telemetry.

Arguments: the address, and how many seconds to count telemetry. Prints a line of JSON.
"""

import json
import os
import sys
import time

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil

address, seconds = sys.argv[1], float(sys.argv[2])
link = mavutil.mavlink_connection("tcp:" + address, autoreconnect=False)
link.write(b"\nbaud 921600\n")
time.sleep(1.0)
# The fastest that this format allows, or nearly so.
link.write(b"\nformat mavlink\n")
time.sleep(0.5)
link.write(b"\nrate 200\n")
beat = link.wait_heartbeat(timeout=20)
assert beat, "no heartbeat"
link.target_system, link.target_component = beat.get_srcSystem(), beat.get_srcComponent()
target = (link.target_system, link.target_component)


def heard(kind, accept=lambda message: True, patience_s=20):
    """Returns the next message of this kind that is accepted."""
    end = time.time() + patience_s
    while time.time() < end:
        message = link.recv_match(type=kind, blocking=True, timeout=1)
        if message and accept(message):
            return message
    raise AssertionError("no " + kind)


link.mav.param_request_list_send(*target)
first = heard("PARAM_VALUE")
values = {first.param_id: first.param_value}
while len(values) < first.param_count:
    message = heard("PARAM_VALUE")
    values[message.param_id] = message.param_value

name = sorted(values)[0]
link.mav.param_request_read_send(*target, name.encode(), -1)
read = heard("PARAM_VALUE", lambda message: message.param_id == name)
assert read.param_value == values[name], (read, values)
link.mav.param_set_send(*target, name.encode(), read.param_value, read.param_type)
heard("PARAM_VALUE", lambda message: message.param_id == name)

results = {}
for command, first in [(241, 1.0), (241, 0.0), (9999, 0.0), (400, 0.0)]:
    parameters = [first, 0, 0, 0, 0, 0, 0]
    link.mav.command_long_send(*target, command, 0, *parameters)
    ack = heard("COMMAND_ACK", lambda message: message.command == command)
    results[f"{command}/{first:.0f}"] = ack.result

counts, started = {}, time.time()
while time.time() < started + seconds:
    message = link.recv_match(blocking=True, timeout=1)
    if message:
        counts[message.get_type()] = counts.get(message.get_type(), 0) + 1
print(
    json.dumps(
        {
            "parameters": len(values),
            "name": name,
            "results": results,
            "counts": counts,
            "lost": link.mav_loss,
            "seconds": time.time() - started,
        }
    )
)
