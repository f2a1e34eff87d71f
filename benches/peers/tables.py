"""The Python side of `tables`: makes the log, and does the peers' work.

    tables.py make N | run COMMAND | versions | sums FOLDER | again FOLDER | longer TIMES | peak COMMAND...
    tables.py asammdf-parquet | asammdf-csv | cantools-parquet
"""
import glob
import os
import resource
import subprocess
import sys

# Per message: identifier, 29 bits, period in ms; signals: name, start, length, signed, factor, offset
# (Intel). Traffic like a 500 kbit/s bus: counters, slow walks, flags, constants, a checksum.
MESSAGES = 60
PERIODS = [5, 10, 10, 10, 20, 20, 20, 50, 50, 100, 100, 100, 200, 500, 1000]
LAYOUTS = [
    [("Value", 16, False, 0.01, 0.0), ("Angle", 16, True, 0.1, 0.0), ("Level", 16, False, 1.0, 0.0),
     ("Force", 16, True, 0.5, -100.0)],
    [("Value", 12, False, 0.25, 0.0), ("Angle", 12, True, 0.0625, 0.0), ("Level", 12, False, 1.0, 0.0),
     ("Force", 12, False, 0.001, 273.15), ("Counter", 4, False, 1.0, 0.0), ("State", 4, False, 1.0, 0.0),
     ("Checksum", 8, False, 1.0, 0.0)],
    [(f"Flag{n}", 1, False, 1.0, 0.0) for n in range(8)]
    + [("Mode", 3, False, 1.0, 0.0), ("Spare", 5, False, 1.0, 0.0), ("Temp", 8, False, 1.0, -40.0),
       ("Angle", 12, True, 0.1, 0.0), ("Value", 12, False, 2.0, 0.0), ("Total", 16, False, 0.1, 0.0)],
    [(f"Cell{n}", 8, False, 0.02, 0.0) for n in range(6)]
    + [("Counter", 8, False, 1.0, 0.0), ("Checksum", 8, False, 1.0, 0.0)],
]
CHOICES = {"State": ["Off", "On", "Init", "Error"], "Mode": ["Park", "Drive", "Reverse"]}


def messages():
    for number in range(MESSAGES):
        extended = number % 5 >= 3
        id = 0x18000000 + number * 0x1101 if extended else 0x80 + number * 27
        yield f"Message{number:02}", id, extended, PERIODS[number % 15], LAYOUTS[number % 4]


def make(count):
    import numpy as np

    random = np.random.default_rng(20231114)
    with open("car.dbc", "w") as file:
        file.write('VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: A B\n\n')
        for name, id, extended, _, layout in messages():
            file.write(f"BO_ {id | (0x80000000 if extended else 0)} {name}: 8 A\n")
            start = 0
            for signal, bits, signed, factor, offset in layout:
                sign = "-" if signed else "+"
                file.write(f' SG_ {name}_{signal} : {start}|{bits}@1{sign} ({factor},{offset}) [0|0] "V" B\n')
                start += bits
            file.write("\n")
        for name, id, extended, _, layout in messages():
            for signal, *_ in layout:
                if signal in CHOICES:
                    values = " ".join(f'{n} "{text}"' for n, text in enumerate(CHOICES[signal]))
                    file.write(f"VAL_ {id | (0x80000000 if extended else 0)} {name}_{signal} {values} ;\n")
    rate = sum(1000 / period for _, _, _, period, _ in messages())
    seconds = count / rate * 1.02 + 2
    times, kinds, data = [], [], []
    for number, (_, _, _, period, layout) in enumerate(messages()):
        n = int(seconds * 1000 / period) + 1
        t = np.arange(n) * period * 1000.0 + random.uniform(0, period * 1000) + random.normal(0, 80, n)
        word = np.zeros(n, dtype=np.uint64)
        start = 0
        for signal, bits, *_ in layout:
            top = 1 << bits
            if signal == "Counter":
                raw = np.arange(n) % top
            elif signal == "Checksum":
                raw = random.integers(0, top, n)
            elif bits <= 4:
                raw = (np.cumsum(random.random(n) < 0.002) % min(top, 4)).astype(np.int64)
            elif signal == "Spare":
                raw = np.zeros(n, dtype=np.int64)
            else:
                raw = (np.cumsum(random.normal(0, top / 5000, n)) + top / 2).astype(np.int64) % top
            word |= raw.astype(np.uint64) << np.uint64(start)
            start += bits
        times.append(t), kinds.append(np.full(n, number)), data.append(word)
    times, kinds, data = np.concatenate(times), np.concatenate(kinds), np.concatenate(data)
    order = np.argsort(times, kind="stable")[:count]
    assert len(order) == count
    times = 1_700_000_000_000_000 + np.maximum.accumulate(times[order].astype(np.int64))
    kinds, data = kinds[order], data[order]
    heads = [f"{id:08X}" if ext else f"{id:03X}" for _, id, ext, *_ in messages()]
    digits = data.astype("<u8").tobytes().hex().upper()
    with open("can.log", "w", buffering=1 << 20) as file:
        for at, (time, kind) in enumerate(zip(times.tolist(), kinds.tolist())):
            file.write(f"({time // 10**6}.{time % 10**6:06}) can0 {heads[kind]}#{digits[16 * at:16 * at + 16]}\n")
    raw_mf4(times, kinds, data)


def raw_mf4(times, kinds, data):
    """The same frames as asammdf takes them: raw bus logging."""
    import numpy as np
    from asammdf import MDF, Signal
    from asammdf.blocks import v4_constants as v4
    from asammdf.blocks.source_utils import Source

    known = list(messages())
    ids = np.array([id for _, id, *_ in known], dtype="<u4")[kinds]
    extended = np.array([ext for _, _, ext, *_ in known], dtype="u1")[kinds]
    types = [("CAN_DataFrame.BusChannel", "u1"), ("CAN_DataFrame.ID", "<u4"), ("CAN_DataFrame.IDE", "u1"),
             ("CAN_DataFrame.DLC", "u1"), ("CAN_DataFrame.DataLength", "u1"),
             ("CAN_DataFrame.DataBytes", "(8,)u1"), ("CAN_DataFrame.Dir", "u1"), ("CAN_DataFrame.EDL", "u1"),
             ("CAN_DataFrame.BRS", "u1"), ("CAN_DataFrame.ESI", "u1")]
    frames = np.zeros(len(times), dtype=types)
    for name, value in [("BusChannel", 1), ("ID", ids), ("IDE", extended), ("DLC", 8), ("DataLength", 8)]:
        frames[f"CAN_DataFrame.{name}"] = value
    frames["CAN_DataFrame.DataBytes"] = data.astype("<u8").view("u1").reshape(-1, 8)
    source = Source("CAN", "CAN", "", source_type=v4.SOURCE_BUS, bus_type=v4.BUS_TYPE_CAN)
    file = MDF(version="4.11")
    signal = Signal(frames, times / 1e6 - 1_700_000_000, name="CAN_DataFrame", source=source)
    file.append([signal], acq_source=source, common_timebase=True)
    file.groups[0].channel_group.flags |= v4.FLAG_CG_BUS_EVENT | v4.FLAG_CG_PLAIN_BUS_EVENT
    file.save("can.mf4", compression=2, overwrite=True)


def run(command):
    subprocess.run(["bash", "-c", command], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def longer(times):
    """The log so many times, one after the other, on stdout."""
    with open("can.log") as file:
        lines = [line.split(" ", 1) for line in file]
    first, last = (float(lines[at][0][1:-1]) for at in (0, -1))
    stamps = [(int(stamp[1:-8]), stamp[-8:]) for stamp, _ in lines]
    for number in range(times):
        shift = number * (int(last - first) + 1)
        rows = zip(stamps, lines)
        sys.stdout.writelines(f"({second + shift}{rest} {text}" for (second, rest), (_, text) in rows)


def peak(command):
    """Runs a command on stdin; writes the most memory it had, in MiB, to a file."""
    subprocess.run(command, check=True)
    print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024, file=open("peak", "w"))


def extracted():
    from asammdf import MDF

    return MDF("can.mf4").extract_bus_logging({"CAN": [("car.dbc", 0)]})


def asammdf_parquet():
    import pyarrow as pa
    import pyarrow.parquet as pq

    os.makedirs("out")
    groups = extracted().iter_groups(ignore_value2text_conversions=True, time_from_zero=False)
    for number, frame in enumerate(groups):
        pq.write_table(pa.Table.from_pandas(frame), f"out/{number:02}.parquet", compression="zstd")


def asammdf_csv():
    os.makedirs("out")
    extracted().export("csv", "out/can.csv")


def cantools_parquet():
    import can
    import cantools
    import pyarrow as pa
    import pyarrow.parquet as pq

    os.makedirs("out")
    database = cantools.database.load_file("car.dbc")
    tables = {(m.frame_id, m.is_extended_frame): (m, [], {s.name: [] for s in m.signals}) for m in database.messages}
    for frame in can.LogReader("can.log"):
        message, times, columns = tables[(frame.arbitration_id, frame.is_extended_id)]
        times.append(frame.timestamp)
        for name, value in message.decode(frame.data, decode_choices=False).items():
            columns[name].append(value)
    for message, times, columns in tables.values():
        arrays = {name: pa.array(values, type=pa.float64()) for name, values in columns.items()}
        pq.write_table(pa.table({"time": times, **arrays}), f"out/{message.name}.parquet", compression="zstd")


def sums(folder):
    """Count and sum of each signal, to nine digits."""
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    lines = []
    for path in glob.glob(f"{folder}/**/*.parquet", recursive=True):
        table = pq.read_table(path, partitioning=None)
        for name in table.column_names:
            if name != "time" and not name.endswith("_label"):
                column = table[name].cast("float64")
                lines.append(f"{name} {len(column)} {pc.sum(column).as_py():.9g}")
    print("\n".join(sorted(lines)))


def again(folder):
    """The same columns as pyarrow writes them with zstd; bytes of all files."""
    import pyarrow.parquet as pq

    total = 0
    for path in glob.glob(f"{folder}/**/*.parquet", recursive=True):
        pq.write_table(pq.read_table(path, partitioning=None), "again.parquet", compression="zstd")
        total += os.path.getsize("again.parquet")
    print(total, file=open("again.bytes", "w"))


def versions():
    import asammdf, can, cantools, pyarrow

    names = [("asammdf", asammdf), ("python-can", can), ("cantools", cantools), ("pyarrow", pyarrow)]
    print(" - ".join(f"{name} {module.__version__}" for name, module in names))


WORK = {"make": lambda: make(int(sys.argv[2])), "run": lambda: run(sys.argv[2]), "sums": lambda: sums(sys.argv[2]),
        "longer": lambda: longer(int(sys.argv[2])), "peak": lambda: peak(sys.argv[2:]),
        "again": lambda: again(sys.argv[2]), "versions": versions, "asammdf-parquet": asammdf_parquet,
        "asammdf-csv": asammdf_csv, "cantools-parquet": cantools_parquet}
WORK[sys.argv[1]]()
