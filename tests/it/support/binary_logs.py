"""BLF and MDF 4 as python-can and asammdf write and read them.

    binary_logs.py write FILE            writes a few hundred frames, prints them
    binary_logs.py read FILE             prints the frames that python-can reads
    binary_logs.py mdf FILE              prints what asammdf says of the file, one JSON object
    binary_logs.py count FILE            prints how many frames python-can reads
    binary_logs.py variant FORM FILE     an MDF file with bus logging in the form of some logger;
                                         prints its frames

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


def count(path):
    with can.LogReader(path) as reader:
        print(sum(1 for _ in reader))


class Blocks:
    """An MDF file that grows block by block. Links are written when their target is known."""

    def __init__(self, unfinished):
        name, flags = (b"UnFinMF ", 0x45) if unfinished else (b"MDF     ", 0)
        self.bytes = bytearray(struct.pack("<8s8s8s4xH30x2H", name, b"4.10    ", b"script  ", 410, flags, 0))

    def add(self, kind, links, data, length=None):
        self.bytes += bytes(-len(self.bytes) % 8)
        at, size = len(self.bytes), 24 + 8 * len(links) + len(data)
        self.bytes += struct.pack("<4s4xQQ", b"##" + kind, length or size, len(links))
        self.bytes += struct.pack(f"<{len(links)}Q", *links) + data
        return at

    def text(self, text):
        return self.add(b"TX", [], text.encode() + b"\0")

    def link(self, at, index, to):
        struct.pack_into("<Q", self.bytes, at + 24 + 8 * index, to)

    def channel(self, name, byte, bits, bit=0, kind=0, role=0, following=0, inside=0, conversion=0, data=0):
        values = struct.pack("<4B4I2BH6d", role, 1 if role == 2 else 0, kind, bit, byte, bits, 0, 0, 0, 0, 0, *[0.0] * 6)
        return self.add(b"CN", [following, inside, self.text(name), 0, conversion, data, 0, 0], values)

    def group(self, following, first, name, record_id, cycles, flags, size, master=0):
        source = self.add(b"SI", [self.text(name), 0, 0], bytes((2, 2, 0, 0, 0, 0, 0, 0)))
        # In column storage a byte a record says what is invalid.
        values = struct.pack("<2Q2H3I", record_id, cycles, flags | (8 if master else 0), 0x2E, 0, size, 1 if master else 0)
        links = [following, first, self.text(name), source, 0, 0, *([master] if master else [])]
        return self.add(b"CG", links, values)

    def packed(self, method, row, data):
        """A compressed block of records: 0 deflate, 2 Zstandard, 4 LZ4; one more for transposed ones."""
        import lz4.frame
        import zstandard

        whole = data
        if method % 2:
            count = len(data) // row
            data = b"".join(data[column:count * row:row] for column in range(row)) + data[count * row:]
        pack = (zlib.compress, zstandard.ZstdCompressor().compress, lz4.frame.compress)[method // 2]
        values = struct.pack("<2s2BIQQ", b"DT", method, 0, row, len(whole), len(pack(data)))
        return self.add(b"DZ", [], values + pack(data))


def variant(form, path):
    draw, unfinished = random.Random(7), form == "unfinished"
    file = Blocks(unfinished)
    header = file.add(b"HD", [0] * 6, struct.pack("<Q2h4B2d", 1795317300_250000000, 0, 0, 2, 0, 0, 0, 0, 0))
    vlsd, order = form.startswith("vlsd"), ">" if form == "motorola" else "<"
    packed, plain, columns = form == "packed", form == "plain-names", form == "columns"
    before = 8 if columns else 0  # bytes of the time, which is apart
    shared = form in ("unsorted", "vlsd-list")
    number, real = (1, 5) if form == "motorola" else (0, 4)
    conversion = file.add(b"CC", [0] * 4, struct.pack("<2B3H4d", 1, 0, 0, 0, 2, 0, 0, 0.5, 1e-6)) if packed else 0

    def fields(event, payload):
        """The channels of an event; where they are in the record is the same in all forms but packed ones."""
        place = {"ID": (8, 32, 0), "IDE": (12, 8, 0), "BusChannel": (13, 8, 0), "DLC": (14, 8, 0),
                 "DataLength": (15, 8, 0), "Dir": (16, 8, 0), "EDL": (17, 8, 0)}
        if packed:
            place = {"ID": (8, 29, 0), "IDE": (11, 1, 7), "BusChannel": (12, 4, 0), "DLC": (12, 4, 4),
                     "DataLength": (13, 7, 0), "Dir": (13, 1, 7), "EDL": (14, 1, 2)}
        if plain:
            del place["BusChannel"]
        prefix, first = ("" if plain else f"{event}."), 0
        if payload:
            options = {"role": 1, "data": payload} if vlsd else {}
            first = file.channel(prefix + "DataBytes", 18 - before, 64 if vlsd else 64 * 8, kind=10, following=first, **options)
        for name, (byte, bits, bit) in place.items():
            first = file.channel(prefix + name, byte - before, bits, bit, kind=number, following=first)
        parent = file.channel(event, 8 - before, 8 * 74, kind=10, inside=first)
        if columns:
            return parent
        return file.channel("t", 0, 64, kind=number if packed else real, role=2, following=parent, conversion=conversion)

    def record(time, frame, payload):
        microseconds, bus, ident, extended, dlc, length, sent, fd = time, *frame
        if packed:
            head = struct.pack("<QI3B3x", microseconds - 500000, ident | extended << 31, bus | dlc << 4,
                               length | sent << 7, fd << 2)
        else:
            head = struct.pack(order + "dI6B", microseconds / 1e6, ident, extended, bus, dlc, length, sent, fd)
        return head + payload

    frames, lines, records, values = [], [], [], bytearray()
    for index in range(200):
        extended, remote = draw.randrange(2), shared and draw.random() < 0.2
        ident = draw.randrange(1 << (29 if extended else 11))
        fd = 0 if remote else int(draw.random() < 0.3)
        length = draw.choice((12, 16, 64)) if fd else draw.randrange(9)
        data, time, bus = draw.randbytes(length), 1000000 + index * 731, draw.randrange(1, 3)
        dlc = {12: 9, 16: 10, 64: 15}.get(length, length)
        frame = (bus, ident, extended, dlc, length, draw.randrange(2), fd)
        payload = struct.pack("<Q", len(values)) if vlsd else data.ljust(64, b"\xEE")
        values += b"" if remote else struct.pack("<I", length) + data
        frames.append((remote, record(time, frame, payload), data))
        letters = "".join(l for l, on in zip("xrft", (extended, remote, fd, frame[5])) if on)
        name = "CAN7" if plain else bus
        lines.append(f"{1795317300250000 + time} {name} {ident:x} {letters} {dlc if remote else ''} "
                     f"{'' if remote else data.hex()}")
    size = 18 + (8 if vlsd else 64)
    count_of = lambda kind: 0 if unfinished else sum(1 for remote, *_ in frames if remote == kind)
    if shared:
        # A value of any length stands in front of its record, or behind it.
        values_group = file.group(0, 0, "values", 3, count_of(False), 1, 0) if vlsd else 0
        remotes = file.group(values_group, fields("CAN_RemoteFrame", 0), "CAN7", 2, count_of(True), 6, size)
        first = file.group(remotes, fields("CAN_DataFrame", values_group or 1), "CAN7", 1, count_of(False), 6, size)
        for index, (remote, whole, data) in enumerate(frames):
            value = b"\3" + struct.pack("<I", len(data)) + data if vlsd and not remote else b""
            pair = [value, bytes((2 if remote else 1,)) + whole]
            records += pair if index % 2 else reversed(pair)
    else:
        signal = 0
        if vlsd:
            half = len(values) // 2
            parts = [file.add(b"SD", [], bytes(part)) for part in (values[:half], values[half:])]
            signal = file.add(b"DL", [0, *parts], struct.pack("<B3xIQQ", 0, 2, 0, half))
        times = 0
        if columns:
            # Since MDF 4.2: the times in a group of their own, which others name as theirs.
            master = file.group(0, file.channel("t", 0, 64, kind=real, role=2), "times", 0, len(frames), 0, 8)
            data = file.add(b"DV", [], b"".join(whole[:8] for _, whole, _ in frames))
            times = file.add(b"DG", [0, master, data, 0], bytes(8))
        first = file.group(0, fields("CAN_DataFrame", signal or 1), "CAN7", 0, count_of(False), 6, size - before,
                           master if columns else 0)
        records = [whole[before:] for _, whole, _ in frames]
    group = file.add(b"DG", [0 if shared else times, first, 0, 0], bytes((1 if shared else 0,)) + bytes(7))
    file.link(header, 0, group)
    if columns:
        half = len(records) // 2
        parts = [file.add(b"DV", [], b"".join(part)) for part in (records[:half], records[half:])]
        bits = [file.add(b"DI", [], bytes(len(part))) for part in (records[:half], records[half:])]
        data = file.add(b"LD", [0, *parts, *bits], struct.pack("<2IQQ", 1 << 31, 2, 0, half))
    elif form in ("zstd", "lz4", "deflate"):
        method = {"deflate": 1, "zstd": 3, "lz4": 4}[form]
        half = len(records) // 2 + 3
        parts = [file.packed(method, size, b"".join(part)) for part in (records[:half], records[half:])]
        data = file.add(b"DL", [0, *parts], struct.pack("<B3xIQQ", 0, 2, 0, half * size))
        data = file.add(b"HL", [data], struct.pack("<HB5x", 0, method))
    else:
        data = file.add(b"DT", [], b"".join(records), length=24 if unfinished else None)
    file.link(group, 2, data)
    with open(path, "wb") as out:
        out.write(file.bytes)
    print("\n".join(lines))


if __name__ == "__main__":
    verb, *rest = sys.argv[1:]
    {"write": write, "read": read, "count": count, "mdf": mdf, "variant": variant}[verb](*rest)
