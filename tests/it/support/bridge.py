#!/usr/bin/env python3
"""A device and an application, both pyserial, that talk through a recorder's bridge.

Prints the port that the recorder shall open, waits for the path of the application's side on
stdin, talks, and prints what was said as JSON.
"""
import json
import os
import pty
import random
import selectors
import sys
import threading
import tty

import serial


def null_modem():
    """Two terminals that hear each other."""
    ends = [pty.openpty(), pty.openpty()]
    for _, slave in ends:
        tty.setraw(slave)

    def carry():
        selector = selectors.DefaultSelector()
        for (here, _), (there, _) in [ends, ends[::-1]]:
            selector.register(here, selectors.EVENT_READ, there)
        while True:
            for key, _ in selector.select():
                data = memoryview(os.read(key.fd, 4096))
                while data:
                    data = data[os.write(key.data, data):]

    threading.Thread(target=carry, daemon=True).start()
    return [os.ttyname(slave) for _, slave in ends]


def exactly(port, count):
    data = port.read(count)
    if len(data) != count:
        sys.exit(f"heard {len(data)} of {count} bytes")
    return data


ports = null_modem()
print(ports[0], flush=True)
device = serial.Serial(ports[1], 19200, timeout=60)
application = serial.Serial(sys.stdin.readline().strip(), 19200, timeout=60)
rng = random.Random(1)
rounds = []
for _ in range(60):
    question = rng.randbytes(rng.randint(1, 300))
    application.write(question)
    if exactly(device, len(question)) != question:
        sys.exit("the device heard something else")
    answer = rng.randbytes(rng.randint(1, 300))
    device.write(answer)
    if exactly(application, len(answer)) != answer:
        sys.exit("the application heard something else")
    rounds.append([question.hex(), answer.hex()])
# And both at once.
up, down = rng.randbytes(40_000), rng.randbytes(40_000)
heard = []
threads = [
    threading.Thread(target=application.write, args=[down]),
    threading.Thread(target=device.write, args=[up]),
    threading.Thread(target=lambda: heard.append(exactly(device, len(down)) == down)),
    threading.Thread(target=lambda: heard.append(exactly(application, len(up)) == up)),
]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
if heard != [True, True]:
    sys.exit("not what was said")
rounds.append([down.hex(), up.hex()])
print(json.dumps(rounds), flush=True)
sys.stdin.readline()
