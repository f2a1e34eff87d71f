#!/usr/bin/env python3
"""A CAN adapter made of two terminals: python-can sends through one, the recorder listens at the
other. Prints the recorder's port, waits until the recorder has opened the bus, sends, and prints
the frames as JSON.
"""
import json
import os
import pty
import random
import sys
import threading
import time
import tty

import can


def lines(fd):
    rest = b""
    while True:
        rest += os.read(fd, 4096)
        *whole, rest = rest.split(b"\r")
        yield from whole


recorder, recorder_slave = pty.openpty()
sender, sender_slave = pty.openpty()
for slave in (recorder_slave, sender_slave):
    tty.setraw(slave)
opened = threading.Event()


def listen():
    """Acknowledges what the recorder commands."""
    for line in lines(recorder):
        os.write(recorder, {b"V": b"V1013\r", b"F": b"F00\r"}.get(line, b"\r"))
        if line[:1] in (b"O", b"L"):
            opened.set()


def pass_on():
    """A frame that python-can sends is one that the recorder's bus carries."""
    for line in lines(sender):
        if line[:1] in (b"t", b"T", b"r", b"R"):
            os.write(recorder, line + b"\r")
            os.write(sender, b"z\r")
        else:
            os.write(sender, b"\r")


for work in (listen, pass_on):
    threading.Thread(target=work, daemon=True).start()
print(os.ttyname(recorder_slave), flush=True)
bus = can.Bus(interface="slcan", channel=os.ttyname(sender_slave), bitrate=500000, sleep_after_open=0)
if not opened.wait(60):
    sys.exit("the recorder did not open the bus")
rng = random.Random(1)
sent = []
for _ in range(300):
    extended, remote = rng.random() < 0.5, rng.random() < 0.2
    message = can.Message(
        arbitration_id=rng.getrandbits(29 if extended else 11),
        is_extended_id=extended,
        is_remote_frame=remote,
        dlc=rng.randint(0, 8) if remote else None,
        data=None if remote else rng.randbytes(rng.randint(0, 8)),
    )
    bus.send(message, timeout=60)
    # python-can does not look at what the adapter answers.
    if rng.random() < 0.1:
        time.sleep(0.01)
    sent.append({
        "id": message.arbitration_id, "ext": extended, "rtr": remote,
        "dlc": message.dlc, "data": bytes(message.data).hex(),
    })
print(json.dumps(sent), flush=True)
sys.stdin.readline()
