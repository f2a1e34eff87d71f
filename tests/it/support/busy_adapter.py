#!/usr/bin/env python3
"""A CAN adapter that speaks the Lawicel ASCII protocol and refuses every third frame once.

Prints its port, then, when its channel is closed, the frames it has taken as JSON.
"""
import json
import os
import pty
import tty

master, slave = pty.openpty()
tty.setraw(slave)
print(os.ttyname(slave), flush=True)
line, taken, refused, opened = b"", [], None, False
while True:
    for byte in os.read(master, 4096):
        if byte != 13:
            line += bytes([byte])
            continue
        command, line = line.decode(), b""
        if command[:1] == "t":
            if len(taken) % 3 == 2 and refused != command:
                refused = command
                os.write(master, b"\a")
            else:
                taken.append(command)
                os.write(master, b"z\r")
        else:
            os.write(master, b"\r")
            opened |= command == "O"
            if command == "C" and opened:
                print(json.dumps(taken), flush=True)
