#!/usr/bin/env python3
"""A supervision computer that polls a rectifier monitor with pyserial.

Written from the protocol's description alone. Arguments: the port, then what to do: "poll" goes
through the rules of the link, "FAULT" expects that fault in every answer, "listen" hears both sides
of a line, "serve" is the other side of a polling master. Exits with a sentence when something is
not as it should be.
"""
import struct
import sys
import time

import serial

LENGTHS = {
    0x0000: 1, 0x0001: 4, 0x0002: 4, 0x0064: 123, 0x0065: 1, 0x007C: 156, 0x00A2: 88, 0x00B6: 4,
    0x00B9: 30, 0x00C8: 9, 0x012C: 5, 0x012D: 12, 0x0197: 123, 0x019A: 4, 0x01A8: 1, 0x01A9: 96,
    0x0259: 240, 0x0289: 4, 0x028A: 56, 0x028B: 1, 0x028C: 1, 0x028D: 13, 0x407E: 48, 0x409C: 24,
    0x40B0: 103, 0x40E2: 40, 0x40EC: 38, 0x40ED: 216, 0x40EE: 8, 0x40EF: 4, 0x40F0: 12, 0x414B: 80,
}


def fail(text):
    sys.exit(f"rectifier_master.py: {text}")


def expect(what, found, expected):
    if found != expected:
        fail(f"{what}: {found!r} instead of {expected!r}")


def crc(data):
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ (0x1021 if value & 0x8000 else 0)) & 0xFFFF
    return value


def encode(address, control, data=b""):
    plain = b"\x7e" + struct.pack(">HBB", address, control, len(data)) + data
    plain += struct.pack(">H", crc(plain))
    out = bytearray(plain[:1])
    for byte in plain[1:]:
        if byte in (0x7E, 0x7D) or byte < 0x20:
            out += bytes([0x7D, byte ^ 0x20])
        else:
            out.append(byte)
    return bytes(out)


class Line:
    def __init__(self, path):
        self.port = serial.Serial(path, 19200, bytesize=8, parity="N", stopbits=1, timeout=0.05)

    def frame(self, patience=3.0):
        """(what, address, control, data) of the next frame; what is None when nothing came."""
        end, plain, escaped, skipped = time.monotonic() + patience, b"", False, 0
        while time.monotonic() < end:
            for byte in self.port.read(1):
                if byte == 0x7E:
                    plain, escaped = b"\x7e", False
                    continue
                if not plain:
                    skipped += 1
                    continue
                if escaped:
                    byte, escaped = byte ^ 0x20, False
                elif byte == 0x7D:
                    escaped = True
                    continue
                plain += bytes([byte])
                if len(plain) >= 7 and len(plain) == 7 + plain[4]:
                    address, control = struct.unpack(">HB", plain[1:4])
                    good = struct.unpack(">H", plain[-2:])[0] == crc(plain[:-2])
                    what = "crc" if not good else "garbage" if skipped else "good"
                    return what, address, control, plain[5:-2]
        return ("incomplete" if plain else None), 0, 0, b""

    def ask(self, control, data, address=1, patience=3.0):
        self.port.write(encode(address, control, data))
        return self.frame(patience)


def poll(line):
    what = line.ask(0x40, b"\x00", address=0)
    expect("the answer to a connect", what, ("good", 1, 0x86, b"\xff"))
    control = 0x45

    def request(data, code=0, address=1):
        nonlocal control
        what, sender, answer, got = line.ask(control, data, address)
        expect(f"the frame of {data.hex()}", (what, sender, answer), ("good", 1, control & 0x20 | 0x85))
        expect(f"the status of {data.hex()}", got[0] & 0x7F, code)
        control ^= 0x20
        return got[1:]

    for number, length in LENGTHS.items():
        data = struct.pack(">H", number) + (b"\x02" if number == 0x40EC else b"")
        expect(f"bytes of {number:04x}", len(request(data, address=0)), length)
    values = struct.unpack(">12f", request(b"\x40\x7e"))
    if not (43 < values[4] < 58 and 40 < values[5] < 160 and 10 < values[10] < 45):
        fail(f"no such plant: {values}")
    # Set, then read.
    expect("the answer to a set", request(b"\x82\x8c\x15"), b"")
    expect("what was set", request(b"\x02\x8c"), b"\x15")
    # What cannot be done.
    request(b"\x00\x03", code=5)
    request(b"\x80\x00\x15", code=1)
    request(b"\x80\x64\x00", code=4)
    request(b"\x40\xec\x40", code=3)
    # The same request again with the same bit: the answer was lost, and comes again.
    first = line.ask(control, b"\x01\x9a")
    expect("a repeated answer", line.ask(control, b"\x01\x9a"), first)
    # Undefined link commands, and those of slaves only.
    for code in (0x42, 0x49, 0x46, 0x48):
        what, sender, answer, got = line.ask(code, b"")
        expect(f"the answer to {code:02x}", (what, answer & 0x0F, answer & 0x80), ("good", 8, 0x80))
    # Not for this monitor, no answer wanted, broadcast, another slave's frame, damaged.
    for address, code in ((2, 0x45), (1, 0x05), (0xFFFF, 0x45), (0xFF00, 0x45), (1, 0x85)):
        expect(f"{code:02x} to {address}", line.ask(code, b"\0\0", address, 0.3)[0], None)
    damaged = bytearray(encode(1, 0x45, b"\x40\x9c"))
    damaged[-1] ^= 0x40
    line.port.write(damaged)
    expect("the answer to a damaged request", line.frame(0.3)[0], None)
    expect("the answer after it", line.ask(0x65, b"\x40\x9c")[0], "good")


def fault(line, name):
    for count in range(6):
        control = 0x45 | (count & 1) << 5
        begin = time.monotonic()
        what, address, answer, got = line.ask(control, b"\x40\x9c", patience=0.4 if name != "late" else 5)
        delay = time.monotonic() - begin
        good = ("good", 1, control & 0x20 | 0x85)
        found = (what, address, answer)
        if name == "bad-crc":
            expect(name, what, "crc")
        elif name == "no-answer":
            expect(name, what, None)
        elif name == "wrong-length" and what not in ("crc", "incomplete"):
            fail(f"{name}: {found}")
        elif name == "garbage":
            expect(name, found, ("garbage", *good[1:]))
        elif name == "late":
            expect(name, found, good)
            if delay < 0.95:
                fail(f"{name}: after {delay} s")
            return
        elif name == "link-error":
            expect(name, found, ("good", 1, control & 0x20 | 0x88))
        elif name == "wrong-sequence":
            expect(name, found, ("good", 1, good[2] ^ 0x20))
        elif name == "wrong-address":
            expect(name, found, ("good", 2, good[2]))
        elif name == "busy":
            expect(name, (*found, got[0] & 0x7F), (*good, 6))
        line.port.reset_input_buffer()


def listen(line):
    """Every answer follows its request on the line."""
    line.frame()
    asked, pairs = None, 0
    while pairs < 6:
        what, _, control, _ = line.frame()
        if what != "good":
            fail(f"heard {what}")
        if control & 0x80 and asked is not None:
            expect("the sequence bit of an answer", control & 0x20, asked & 0x20)
            pairs += 1
        asked = None if control & 0x80 else control


def serve(line):
    """A slave that does not answer at first."""
    hear = lambda: line.frame(5)[1:3]
    expect("a call", hear(), (9, 0x40))
    line.port.write(encode(9, 0x86, b"\xff"))
    expect("the first request", hear(), (9, 0x45))
    expect("the same again", hear(), (9, 0x45))
    bit = 0
    for _ in range(8):
        line.port.write(encode(9, 0x85 | bit, b"\x00" + bytes(4)))
        bit ^= 0x20
        expect("the next request", hear(), (9, 0x45 | bit))


def main():
    line, what = Line(sys.argv[1]), sys.argv[2]
    {"poll": poll, "listen": listen, "serve": serve}.get(what, lambda line: fault(line, what))(line)


main()
