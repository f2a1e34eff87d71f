"""Frames of foreign logs as bustape and other readers have them: corpus.py BUSTAPE FOLDER..."""

import csv
import fnmatch
import io
import os
import subprocess
import sys
import warnings
from collections import Counter

warnings.simplefilter("ignore")
sys.stderr.flush()

# Why the peer's reading is not bustape's, by the end of the path. The first that fits is the one.
NO_BIT = ("identifiers above 7FF whose bit for 29 bits is not set have 11 bits for python-can; "
          "requests to send (2) are received frames for it")
FD_REMOTE = "python-can calls remote frames of a channel with CAN FD frames of CAN FD, which has none"
EXPLAINED = [
    ("empty.blf", "the file has no byte"),
    ("FileWithoutLogContainers.blf", "python-can passes over frames outside of containers"),
    ("test_CanErrorFrame.blf", "python-can does not know CAN_ERROR"),
    ("test_CanFdErrorFrame64.blf", "python-can does not know CAN_FD_ERROR_64"),
    ("test_GlobalMarker.blf", "its only object ends 27 bytes before its container does; python-can stops there"),
    ("test_CanFdMessage64.blf", "its flags say CAN FD and remote at once: for bustape it has its data"),
    ("test_CanFdMessage.blf", NO_BIT),
    ("test_CanMessage*.blf", NO_BIT),
    ("errors/FileWith*.blf", NO_BIT),
    ("*logfile.asc", FD_REMOTE),
    ("test_CanFdRemoteMessage.asc", FD_REMOTE),
    ("single_frame.asc", "a frame of 64 bytes, of which python-can takes 8"),
    ("modified-format.pcap", "a variant of pcap that neither reads, without CAN frames"),
]


def kind(path):
    with open(path, "rb") as file:
        head = file.read(8)
    if head.startswith(b"LOGG"):
        return "blf"
    if head.startswith((b"MDF ", b"UnFinMF")):
        return "mf4"
    if head[:4] in (b"\x0a\x0d\x0d\x0a", b"\xd4\xc3\xb2\xa1", b"\xa1\xb2\xc3\xd4", b"\x4d\x3c\xb2\xa1", b"\xa1\xb2\x3c\x4d"):
        return "pcap"
    return os.path.splitext(path)[1][1:].lower()


def frame(time, ident, ext, rtr, error, fd, brs, esi, tx, dlc, data):
    """What two readers must agree on; of error frames, only that they are there, and when."""
    if error:
        return (time, "error")
    flags = "".join(letter for letter, on in zip("xrfbst", (ext, rtr, fd, brs, esi, tx)) if on)
    return (time, f"{ident:x}", flags, dlc if rtr else "", "" if rtr else data.hex())


def of_message(m):
    return frame(m.timestamp, m.arbitration_id, m.is_extended_id, m.is_remote_frame, m.is_error_frame, m.is_fd,
                 m.bitrate_switch, m.error_state_indicator, not m.is_rx, m.dlc, bytes(m.data))


def of_pcap(path):
    from scapy.layers.can import CAN, CANFD
    from scapy.utils import PcapReader

    for packet in PcapReader(path):
        kinds = [layer for layer in (CANFD, CAN) if layer in packet]
        if not kinds:
            continue
        can, fd = packet[kinds[0]], kinds[0] is CANFD
        flags, fd_flags = int(can.flags), int(can.fd_flags) if fd else 0
        yield frame(float(packet.time), int(can.identifier), bool(flags & 4), bool(flags & 2), bool(flags & 1), fd,
                    bool(fd_flags & 1), bool(fd_flags & 2), False, can.length, bytes(can.data))


def theirs(path, form):
    """The reader's name, its frames, and what it stopped for."""
    import can
    from can.io import ASCReader, BLFReader, CanutilsLogReader, MF4Reader, TRCReader

    readers = {"blf": BLFReader, "mf4": MF4Reader, "trc": TRCReader, "log": CanutilsLogReader,
               "asc": lambda path: ASCReader(path, relative_timestamp=False)}
    name = "scapy" if form == "pcap" else "python-can"
    frames = []
    try:
        if form == "pcap":
            for found in of_pcap(path):
                frames.append(found)
        else:
            with readers[form](path) as reader:
                for message in reader:
                    frames.append(of_message(message))
    except Exception as error:  # any of them: that is what is looked at
        return name, frames, f"{type(error).__name__}: {error}"[:90]
    return name, frames, ""


def ours(bustape, path):
    """The frames, the exit status, and the first sentence of what was said."""
    ran = subprocess.run([bustape, "export", path, "--format", "frames-csv", "-o", "-"], capture_output=True)
    flag = lambda row, *names: [row[name] == "1" for name in names]
    frames = [
        frame(float(row["time"]), int(row["id"], 16), *flag(row, "ext", "rtr", "error", "fd", "brs", "esi"),
              row["dir"] == "tx", int(row["dlc"]), bytes.fromhex(row["data"]))
        for row in csv.DictReader(io.StringIO(ran.stdout.decode()))
    ]
    said = [line for line in ran.stderr.decode().splitlines() if "frames in =" not in line]
    # Without the name of the file, which the row has.
    said = said[0].replace(path + ": ", "").replace("bustape: ", "") if said else ""
    return frames, ran.returncode, said


def compare(mine, other):
    """Where two lists of frames differ; empty if they do not."""
    if len(mine) != len(other):
        return f"{len(mine)} and {len(other)} frames"
    bare = [Counter(one[1:] for one in frames) for frames in (mine, other)]
    if bare[0] != bare[1]:
        left = next(iter((bare[0] - bare[1]).elements()))
        right = next(iter((bare[1] - bare[0]).elements()))
        return f"contents: {left} and {right}"
    if mine:
        # Logs without a date begin at different zeros; what is compared is the distance.
        spans = [max(one[0] for one in frames) - min(one[0] for one in frames) for frames in (mine, other)]
        if abs(spans[0] - spans[1]) > 2e-6:
            return f"times: from first to last {spans[0]:.6f} s and {spans[1]:.6f} s"
        starts = [min(one[0] for one in frames) for frames in (mine, other)]
        if min(starts) > 1e8 and abs(starts[0] - starts[1]) > 1e-3:
            return f"times: the first is {starts[0] - starts[1]:.3f} s off"
    return ""


def explanation(path):
    return next((text for pattern, text in EXPLAINED if fnmatch.fnmatch(path, "*/" + pattern)), "")


def main(bustape, *folders):
    rows, unexplained = [], 0
    for folder in folders:
        paths = [os.path.join(at, name) for at, _, names in os.walk(folder) for name in names]
        for path in sorted(paths):
            form = kind(path)
            if form not in ("blf", "mf4", "pcap", "trc", "asc", "log"):
                continue
            mine, status, said = ours(bustape, path)
            name, other, stopped = theirs(path, form)
            difference = compare(mine, other)
            if stopped and not difference and mine:
                difference = "the peer stops"
            why = explanation(path) if difference or status not in (0, 3) or stopped else ""
            failed = bool(difference or status not in (0, 3)) and not why
            unexplained += failed
            rows.append((os.path.relpath(path, folder), form, len(mine), status, name, len(other), difference, stopped, said, why, failed))
    for where, form, count, status, name, number, difference, stopped, said, why, failed in rows:
        print(f"{'! ' if failed else '  '}{where}: {form}, {count} (exit {status}), {name} {number}")
        for label, text in (("differs", difference), (name, stopped), ("bustape", said), ("because", why)):
            if text and (difference or stopped or status or label == "because"):
                print(f"      {label}: {text}")
    by_form = Counter(row[1] for row in rows)
    equal = Counter(row[1] for row in rows if not row[6])
    frames = Counter()
    for row in rows:
        frames[row[1]] += row[2]
    print()
    for form in sorted(by_form):
        print(f"{form}: {by_form[form]} files, {frames[form]} frames, {equal[form]} equal")
    print(f"{len(rows)} files, {unexplained} with a difference that nothing explains")
    return 1 if unexplained else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
