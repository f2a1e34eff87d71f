"""Reads every message of an MCAP file, without decoding its payload: read.py FILE"""
import sys

from mcap.reader import make_reader

count = size = 0
with open(sys.argv[1], "rb") as file:
    for _, _, message in make_reader(file).iter_messages():
        count += 1
        size += len(message.data)
print(count, size)
