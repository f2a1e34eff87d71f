"""Makes the logs of `readers`, and what the programs should print of them, in the current folder."""

import random

draw = random.Random(3)
LENGTHS = [0, 1, 5, 8, 12, 16, 24, 64]


def frames():
    """Bus, identifier, kind, sent, data or length, flags of CAN FD."""
    for number in range(180):
        extended = number % 4 > 1
        ident = draw.randrange(16, 1 << (29 if extended else 11))
        kind = ("data", "remote", "fd")[number % 3]
        body = draw.randrange(1, 9) if kind == "remote" else draw.randbytes(LENGTHS[number % (8 if kind == "fd" else 4)])
        yield 1700000000000000 + number * 997, number % 2, ident, extended, kind, draw.random() < 0.3, body, number % 4


def line(time, bus, ident, extended, kind, sent, body, flags):
    digits = f"{ident:08X}" if extended else f"{ident:03X}"
    text = {"data": "#{}", "remote": "#R{}", "fd": f"##{4 + flags}{{}}"}[kind]
    text = text.format(body if kind == "remote" else body.hex().upper())
    return f"({time // 10**6}.{time % 10**6:06}) can{bus} {digits}{text} {'T' if sent else 'R'}\n"


def tshark(time, bus, ident, extended, kind, sent, body, flags):
    fields = [f"{time // 10**6}.{time % 10**6:06}000", f"can{bus}", f"0x{2 if sent else 1:08x}", ident, int(extended)]
    length = body if kind == "remote" else len(body)
    fields += {"data": [0, length, "", ""], "remote": [1, length, "", ""], "fd": ["", length, flags & 1, flags >> 1]}[kind]
    return " ".join(map(str, fields + ["" if kind == "remote" else body.hex()])).rstrip() + "\n"


every = list(frames())
for name, wanted in [("mixed", ("data", "remote", "fd")), ("classic", ("data", "remote")), ("data", ("data",))]:
    with open(name + ".log", "w") as file:
        file.writelines(line(*frame) for frame in every if frame[4] in wanted)
with open("tshark-can.txt", "w") as file:
    file.writelines(tshark(*frame) for frame in every)
with open("serial.txt", "w") as log, open("tshark-serial.txt", "w") as wanted:
    for number in range(40):
        time, sent, data = f"1700000000.{number * 1000001:09}", number % 3 == 0, draw.randbytes(number % 7 + 1)
        log.write(f"({time}) rect {'tx' if sent else 'rx'}  {data.hex(' ').upper()}\n")
        wanted.write(f"{time} rect 0x{2 if sent else 1:08x} {data.hex()}\n")
