"""The Python side of `logs`: logs.py count FILE (python-can, scapy) | columns FILE (asammdf)"""

import sys


def count(path):
    if path.endswith(".pcapng"):
        from scapy.utils import PcapNgReader

        return sum(1 for _ in PcapNgReader(path))
    import can

    with can.LogReader(path) as reader:
        return sum(1 for _ in reader)


def columns(path):
    from asammdf import MDF

    with MDF(path) as file:
        groups = [n for n, group in enumerate(file.groups) if group.channels[1].name == "CAN_DataFrame"]
        return sum(len(file.get("CAN_DataFrame", group=group)) for group in groups)


print({"count": count, "columns": columns}[sys.argv[1]](sys.argv[2]))
