"""Writes a file as other programs do, with the Python library: foreign.py OUT COMPRESSION CHUNKED."""

import sys

from mcap.writer import CompressionType, Writer

out, compression, chunked = sys.argv[1:4]
with open(out, "wb") as file:
    writer = Writer(
        file,
        chunk_size=2000,
        compression=CompressionType[compression],
        use_chunking=chunked == "chunked",
    )
    writer.start("some profile", library="some library")
    schema = writer.register_schema("a.Type", "jsonschema", b'{"type":"object"}')
    channels = [
        writer.register_channel(f"/topic/{n}", "octets", schema, {"n": str(n)}) for n in range(3)
    ]
    writer.add_attachment(5, 6, "../evil name", "text/plain", b"attached " * 1000)
    writer.add_metadata("some metadata", {"key": "value"})
    for n in range(1000):
        data = b'{"number":%d}' % n
        writer.add_message(channels[n % 3], 10**18 + n * 1000, data, 10**18 + n, n)
    writer.finish()
