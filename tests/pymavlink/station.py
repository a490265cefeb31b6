"""A ground station made of pymavlink, at the other end of a pipe.

In turns: reads a length (4 bytes, little-endian) and that many bytes of the module, and answers
with a length and the bytes that the station sends. A length of 0xFFFFFFFF ends it; then it prints
what it saw, one thing a line.
"""

import struct
import sys

from pymavlink.dialects.v20 import common

station = common.MAVLink(None, srcSystem=255, srcComponent=190)
reader = common.MAVLink(None)
reader.robust_parsing = False  # Whatever is no message or has a wrong checksum raises.
report = []
last_sequence = None


def command(number, parameters):
    message = common.MAVLink_command_long_message(1, 1, number, 0, *parameters)
    return message.pack(station)


def command_int(number, x):
    message = common.MAVLink_command_int_message(1, 1, 0, number, 0, 0, 0, 0, 0, 0, x, 0, 0)
    return message.pack(station)


CALIBRATE = common.MAV_CMD_PREFLIGHT_CALIBRATION
HEARTBEAT = common.MAVLink_heartbeat_message(
    common.MAV_TYPE_GCS, common.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3
)

# What the station says, by turn.
SCRIPT = {
    5: lambda: HEARTBEAT.pack(station),
    10: lambda: common.MAVLink_param_request_list_message(1, 1).pack(station),
    60: lambda: common.MAVLink_param_set_message(1, 1, b"OUT_RATE_HZ", 25.0, 9).pack(station),
    70: lambda: common.MAVLink_param_request_read_message(1, 1, b"OUT_BAUD", -1).pack(station),
    80: lambda: command(CALIBRATE, [1, 0, 0, 0, 0, 0, 0]),
    90: lambda: command_int(CALIBRATE, 2),
    100: lambda: command(31999, [0] * 7),  # Nobody knows this one.
    110: lambda: common.MAVLink_mission_request_list_message(1, 1, 0).pack(station),
    120: lambda: command(common.MAV_CMD_REQUEST_MESSAGE, [148, 0, 0, 0, 0, 0, 0]),
    130: lambda: common.MAVLink_system_time_message(0, 0).pack(station),
    140: lambda: b"status\n",
}


def see(message):
    global last_sequence
    sequence = message.get_seq()
    if last_sequence is not None and sequence != (last_sequence + 1) % 256:
        report.append(f"GAP {last_sequence} {sequence}")
    last_sequence = sequence
    if (message.get_srcSystem(), message.get_srcComponent()) != (1, 1):
        report.append("STRANGER")
    fields = message.to_dict()
    kind = fields.pop("mavpackettype")
    report.append(" ".join([kind] + [f"{name}={value!r}" for name, value in fields.items()]))


turn = 0
while True:
    (length,) = struct.unpack("<I", sys.stdin.buffer.read(4))
    if length == 0xFFFFFFFF:
        break
    for message in reader.parse_buffer(sys.stdin.buffer.read(length)) or []:
        see(message)
    answer = bytes(SCRIPT[turn]()) if turn in SCRIPT else b""
    sys.stdout.buffer.write(struct.pack("<I", len(answer)) + answer)
    sys.stdout.buffer.flush()
    turn += 1
sys.stdout.buffer.write("\n".join(report).encode() + b"\n")
