"""Reads a log with python-can (or scapy, for pcapng) and prints one JSON object a frame.

    logs.py read FILE       one line a frame
    logs.py write FILE      writes the frames of stdin, as `read` prints them, with python-can
"""

import json
import sys
import warnings

warnings.simplefilter("ignore")


def of_message(message):
    return {
        "time": round(message.timestamp * 1e6),
        "bus": message.channel,
        "id": message.arbitration_id,
        "ext": message.is_extended_id,
        "rtr": message.is_remote_frame,
        "error": message.is_error_frame,
        "fd": message.is_fd,
        "brs": message.bitrate_switch,
        "esi": message.error_state_indicator,
        "tx": not message.is_rx,
        "dlc": message.dlc,
        "data": "" if message.is_remote_frame else bytes(message.data).hex(),
    }


def of_pcapng(path):
    from scapy.layers.can import CAN, CANFD
    from scapy.utils import PcapNgReader, RawPcapNgReader

    for data, about in RawPcapNgReader(path):
        kind = CANFD if data[5] & 4 else CAN
        frame = kind(data)
        flags = int(frame.flags)
        nanos = (about.tshigh << 32 | about.tslow) * 1_000_000_000 // about.tsresol
        yield {
            "time": nanos // 1000,
            "bus": about.ifname.decode() if about.ifname else None,
            "id": int(frame.identifier),
            "ext": bool(flags & 4),
            "rtr": bool(flags & 2),
            "error": bool(flags & 1),
            "fd": kind is CANFD,
            "brs": kind is CANFD and bool(data[5] & 1),
            "esi": kind is CANFD and bool(data[5] & 2),
            "tx": False,
            "dlc": frame.length,
            "data": "" if flags & 2 else bytes(frame.data).hex(),
        }


def read(path):
    import can

    if path.endswith(".pcapng"):
        return of_pcapng(path)
    options = {"relative_timestamp": False} if path.endswith(".asc") else {}
    return (of_message(message) for message in can.LogReader(path, **options))


def write(path):
    import can

    with can.Logger(path) as log:
        for line in sys.stdin:
            frame = json.loads(line)
            log.on_message_received(
                can.Message(
                    timestamp=frame["time"] / 1e6,
                    channel=frame["bus"],
                    arbitration_id=frame["id"],
                    is_extended_id=frame["ext"],
                    is_remote_frame=frame["rtr"],
                    is_error_frame=frame["error"],
                    is_fd=frame["fd"],
                    bitrate_switch=frame["brs"],
                    error_state_indicator=frame["esi"],
                    is_rx=not frame["tx"],
                    dlc=frame["dlc"],
                    data=bytes.fromhex(frame["data"]),
                )
            )


if sys.argv[1] == "write":
    write(sys.argv[2])
else:
    for frame in read(sys.argv[2]):
        print(json.dumps(frame))
