"""Reads a file of what a UART sent. Prints the attitudes and the faults, one a line."""

import sys

from pymavlink.dialects.v20 import common

reader = common.MAVLink(None)
reader.robust_parsing = True  # Lines of text come before and after.
last = None
for message in reader.parse_buffer(open(sys.argv[1], "rb").read()):
    if message.get_type() == "BAD_DATA":
        print("OTHER", bytes(message.data).hex())
        continue
    sequence = message.get_seq()
    if last is not None and sequence != (last + 1) % 256:
        print("GAP", last, sequence)
    last = sequence
    if message.get_type() == "ATTITUDE_QUATERNION":
        print("Q", message.time_boot_ms, message.q1, message.q2, message.q3, message.q4)
    else:
        print(message.get_type())
