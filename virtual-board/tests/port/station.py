"""A ground station at the virtual board's TCP port: parameters, commands, and telemetry.

Arguments: the address, and for how many seconds of the board's time to count telemetry. Prints a
line of JSON. The board may be much slower than real time on a busy computer, so every wait is for
an answer or for the board's time. PATIENCE_S only ends a station that hangs.
"""

import json
import os
import sys
import time

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil

PATIENCE_S = 300
# The board hears nothing before it has started.
ASK_AGAIN_S = 2
# What carries the board's time.
ATTITUDES = ["ATTITUDE", "ATTITUDE_QUATERNION"]

address, seconds = sys.argv[1], float(sys.argv[2])
link = mavutil.mavlink_connection("tcp:" + address, autoreconnect=False)


def ask(command, answer):
    """Sends a command of the console until its answer comes, as text."""
    end, next_question, text = time.time() + PATIENCE_S, 0.0, b""
    while answer not in text:
        assert time.time() < end, (command, text[-500:])
        if time.time() > next_question:
            link.write(b"\n" + command + b"\n")
            next_question = time.time() + ASK_AGAIN_S
        text = (text + bytes(link.recv(4096) or b""))[-10_000:]
        time.sleep(0.01)


ask(b"baud 921600", b"# ok baud")
beat, end = None, time.time() + PATIENCE_S
while not beat:
    # The board is deaf while it changes its baud rate.
    assert time.time() < end, "no heartbeat"
    link.write(b"\nformat mavlink\n")
    beat = link.wait_heartbeat(timeout=ASK_AGAIN_S)
# The fastest that this format allows, or nearly so.
link.write(b"\nrate 200\n")
link.target_system, link.target_component = beat.get_srcSystem(), beat.get_srcComponent()
target = (link.target_system, link.target_component)


def heard(kind, accept=lambda message: True):
    """Returns the next message of this kind that is accepted."""
    end = time.time() + PATIENCE_S
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

counts, end = {}, time.time() + PATIENCE_S
first_ms = now_ms = heard(ATTITUDES).time_boot_ms
while now_ms < first_ms + 1000 * seconds:
    assert time.time() < end, counts
    message = link.recv_match(blocking=True, timeout=1)
    if message:
        counts[message.get_type()] = counts.get(message.get_type(), 0) + 1
        if message.get_type() in ATTITUDES:
            now_ms = message.time_boot_ms
print(
    json.dumps(
        {
            "parameters": len(values),
            "name": name,
            "results": results,
            "counts": counts,
            "lost": link.mav_loss,
            "seconds": (now_ms - first_ms) / 1000,
        }
    )
)
