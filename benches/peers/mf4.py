"""Writes a log of candump -L as MF4 bus logging (CAN_DataFrame), compressed: mf4.py LOG FILE"""
import sys

import numpy as np
from asammdf import MDF, Signal
from asammdf.blocks import v4_constants as v4
from asammdf.blocks.source_utils import Source

FIELDS = [("BusChannel", "u1"), ("ID", "<u4"), ("IDE", "u1"), ("DLC", "u1"), ("DataLength", "u1"),
          ("DataBytes", "u1", (8,)), ("Dir", "u1"), ("EDL", "u1"), ("BRS", "u1"), ("ESI", "u1")]

log, file = sys.argv[1:]
times, ids, extended, data = [], [], [], []
with open(log) as lines:
    for line in lines:
        stamp, _, frame = line.split()
        number, payload = frame.split("#")
        times.append(int(stamp[1:-1].replace(".", "")))
        ids.append(int(number, 16))
        extended.append(len(number) > 3)
        data.append(payload)

rows = np.zeros(len(times), np.dtype([("CAN_DataFrame." + f[0], *f[1:]) for f in FIELDS]))
rows["CAN_DataFrame.BusChannel"] = 1
rows["CAN_DataFrame.ID"] = ids
rows["CAN_DataFrame.IDE"] = extended
rows["CAN_DataFrame.DLC"] = rows["CAN_DataFrame.DataLength"] = 8
rows["CAN_DataFrame.DataBytes"] = np.frombuffer(bytes.fromhex("".join(data)), "u1").reshape(-1, 8)
seconds = (np.array(times) - times[0]) / 1e6

bus = Source(name="CAN", path="CAN", comment="", source_type=v4.SOURCE_BUS, bus_type=v4.BUS_TYPE_CAN)
mdf = MDF(version="4.11")
mdf.append([Signal(rows, seconds, name="CAN_DataFrame", source=bus)], acq_source=bus, common_timebase=True)
mdf.groups[0].channel_group.flags |= v4.FLAG_CG_BUS_EVENT | v4.FLAG_CG_PLAIN_BUS_EVENT
mdf.save(file, compression=2, overwrite=True)
