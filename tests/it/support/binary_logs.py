"""BLF and MDF 4 as python-can and asammdf write and read them.

    binary_logs.py write FILE            writes a few hundred frames, prints them
    binary_logs.py read FILE             prints the frames that python-can reads
    binary_logs.py mdf FILE              prints what asammdf says of the file, one JSON object
    binary_logs.py variant NAME FILE     an MDF file with bus logging as loggers write it, prints
                                         its frames (see VARIANTS)

A frame is one line: nanoseconds, channel, id, flags, dlc of remote frames, data. Times are rounded
to microseconds, since python-can has them as floating point seconds.
"""
import json
import random
import struct
import sys
import zlib

import can


def line(message, offset=0):
    kinds = (("x", message.is_extended_id), ("r", message.is_remote_frame), ("e", message.is_error_frame),
             ("f", message.is_fd), ("b", message.bitrate_switch), ("s", message.error_state_indicator),
             ("t", not message.is_rx))
    flags = "".join(letter for letter, given in kinds if given)
    if message.is_error_frame:
        flags = flags.replace("x", "").replace("t", "")
    dlc = message.dlc if message.is_remote_frame else ""
    data = "" if message.is_remote_frame else bytes(message.data).hex()
    channel = -1 if message.channel is None else message.channel + offset
    return f"{round(message.timestamp * 1e6)} {channel} {message.arbitration_id:x} {flags} {dlc} {data}"


def messages(errors_have_data):
    draw = random.Random(5)
    for number in range(300):
        message = can.Message(timestamp=1795317300.25 + number * 0.000731, channel=draw.randrange(2),
                              is_rx=draw.random() < 0.7)
        message.is_extended_id = draw.random() < 0.5
        message.arbitration_id = draw.randrange(1 << (29 if message.is_extended_id else 11))
        kind = draw.randrange(8)
        if kind == 0:
            message.is_remote_frame, message.dlc = True, draw.randrange(9)
        elif kind == 1:
            message.is_error_frame, message.is_extended_id, message.is_rx = True, False, True
            message.arbitration_id = draw.randrange(1, 0x400)
            message.data = bytearray(draw.randbytes(8)) if errors_have_data else bytearray()
            message.dlc = len(message.data)
        else:
            message.is_fd = kind in (2, 3)
            message.bitrate_switch = kind == 2
            message.error_state_indicator = kind == 3
            length = draw.choice((0, 8, 12, 16, 20, 24, 32, 48, 64)) if message.is_fd else draw.randrange(9)
            message.data, message.dlc = bytearray(draw.randbytes(length)), length
        yield message


def write(path):
    # python-can's reader gives no data of errors in MDF files of its own.
    with can.Logger(path) as logger:
        for message in messages(True):
            logger(message)


def read(path):
    offset = 1 if path.endswith(".blf") else 0
    with can.LogReader(path) as reader:
        for message in reader:
            print(line(message, offset))


def mdf(path):
    from asammdf import MDF
    with MDF(path) as file:
        groups = [[g.channel_group.acq_name, g.channel_group.cycles_nr, [c.name for c in g.channels]] for g in file.groups]
        ids = {str(bus): sorted(ids) for bus, ids in file.bus_logging_map["CAN"].items()}
        print(json.dumps({"version": file.version, "start": file.header.start_time.timestamp(), "groups": groups,
                          "ids": ids}))


if __name__ == "__main__":
    verb, *rest = sys.argv[1:]
    {"write": write, "read": read, "mdf": mdf}[verb](*rest)
