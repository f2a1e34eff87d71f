#!/usr/bin/env python3
"""A master that asks a device what its recorded master asked, in another order and as fast as it can.

It knows the protocol by itself: frames of the Zhongheng 09 monitors, CRC, escapes, sequence bit.
Reads "PORT DUMP REPEAT UNKNOWN ROUNDS" from stdin: the text of the recorded dialogue; whether its
answers come in a cycle or the last one stays; whether an unknown request gets silence or an error;
how often everything is asked. Prints what it found.
"""
import json
import random
import re
import sys

import serial

PORT, DUMP, REPEAT, UNKNOWN, ROUNDS = sys.stdin.readline().split()


def crc(data):
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ 0x1021 if value & 0x8000 else value << 1) & 0xFFFF
    return value


def frames(data):
    """Whole frames in bytes of a line, unescaped, with a good CRC."""
    found = []
    for part in data.split(b"\x7e")[1:]:
        plain, escaped = bytearray(b"\x7e"), False
        for byte in part:
            if escaped:
                plain.append(byte ^ 0x20)
                escaped = False
            elif byte == 0x7D:
                escaped = True
            else:
                plain.append(byte)
        if len(plain) >= 7 and len(plain) == plain[4] + 7:
            if crc(plain[:-2]) == int.from_bytes(plain[-2:], "big"):
                found.append(bytes(plain))
    return found


def on_line(frame):
    frame = frame[:-2] + crc(frame[:-2]).to_bytes(2, "big")
    line = bytearray(b"\x7e")
    for byte in frame[1:]:
        line += bytes([0x7D, byte ^ 0x20]) if byte in (0x7E, 0x7D) or byte < 0x20 else bytes([byte])
    return bytes(line)


def with_sequence(frame, sequence):
    frame = bytearray(frame)
    frame[3] = frame[3] & ~0x20 | sequence << 5
    return bytes(frame)


# The recorded dialogue, from its text: who asked what, and what was answered, in order.
said = []
for row in open(DUMP):
    match = re.match(r"(?:\(\S+\) \S+ (rx|tx)  | {10,})((?:[0-9A-F]{2} )+)", row)
    way, data = match.group(1), bytes.fromhex(match.group(2))
    if way and (not said or said[-1][0] != way):
        said.append([way, b""])
    said[-1][1] += data
answers, asked = {}, None
for way, data in said:
    for frame in frames(data):
        key = with_sequence(frame, 0)[:-2]
        if way == "tx":
            asked = key
            answers.setdefault(asked, [])
        elif asked is not None:
            answers[asked].append(with_sequence(frame, 0)[:-2])
            asked = None

port = serial.Serial(PORT, 19200, timeout=0.05)
problems, count, repeats, pending = [], 0, 0, {}
rng = random.Random(5)


def ask(frame, sequence, patience=100):
    global count
    count += 1
    port.write(on_line(with_sequence(frame + b"\0\0", sequence)))
    heard = b""
    for _ in range(patience):
        heard += port.read(1) + port.read(port.in_waiting)
        if frames(heard):
            return frames(heard)[0]
    return None


# What no slave knows as a request of its link is not asked: only to connect, and single commands.
requests = [key for key, known in answers.items() if known and key[3] & 0x0F in (0, 5)]
for round in range(int(ROUNDS)):
    rng.shuffle(requests)
    for key in requests:
        sequence = rng.randrange(2)
        answer = ask(key, sequence)
        known, turn = answers[key], pending.get(key, 0)
        turn_of = turn % len(known) if REPEAT == "cycle" else min(turn, len(known) - 1)
        expected = with_sequence(known[turn_of], sequence)
        if answer is None or answer[:-2] != expected:
            problems.append([key.hex(), sequence, expected.hex(), answer and answer.hex()])
        if turn >= len(known):
            repeats += 1
        pending[key] = turn + 1

# A command that nobody recorded: the monitor's own refusal, SLAVE_INVALID_DATA_ID_R.
request = bytes.fromhex("7e000145023abc")
refusal = ask(request, 1, 100 if UNKNOWN == "error" else 6)
good = refusal is None
if UNKNOWN == "error":
    good = refusal is not None and refusal[5:-2] == b"\x05" and refusal[3] == 0xA5
if not good:
    problems.append(["refusal", refusal and refusal.hex()])
# A damaged request is not answered.
damaged = bytearray(on_line(requests[0] + b"\0\0"))
damaged[-1] ^= 1 if damaged[-1] not in (0x7F, 0x7C, 0x5F) else 2
port.write(damaged)
if port.read(100):
    problems.append("a damaged request was answered")
# The highest bit of a command says that it sets something.
sets = sum(len(key) > 7 and key[3] & 0x0F == 5 and key[5] & 0x80 != 0 for key in requests)
found = {"kinds": len(requests), "sets": sets, "repeats": repeats, "asked": count}
print(json.dumps({"problems": problems[:5], **found}))
