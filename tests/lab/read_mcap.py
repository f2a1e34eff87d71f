#!/usr/bin/env python3
"""Prints an MCAP file as lines of JSON, read by the reference Python library.

    read_mcap.py FILE             through the summary and the index
    read_mcap.py --stream FILE    from the start, record by record, until the
                                  data ends: for a file that was never finished

The first line describes the file, each further line is one message (see
README.md).  Exit status 1, and what is wrong on stderr and in the first line,
when the library or one of the checks here finds a fault; any Python warning is
one.  Runs itself again with the pinned libraries that ./peers provides.
"""
import argparse
import hashlib
import io
import json
import math
import os
import struct
import subprocess
import sys
import tempfile
import warnings
import zlib
from collections import Counter

HERE = os.path.dirname(os.path.realpath(__file__))
if not os.environ.get("BUSTAPE_PEERS_PYTHON"):
    peers = os.environ.get("BUSTAPE_PEERS")
    if not peers:
        run = subprocess.run([os.path.join(HERE, "peers")], stdout=subprocess.PIPE, text=True)
        if run.returncode:
            sys.exit(run.returncode)
        peers = run.stdout.strip()
    os.environ["BUSTAPE_PEERS_PYTHON"] = "1"
    python = os.path.join(peers, "venv/bin/python")
    os.execv(python, [python, *sys.argv])

warnings.simplefilter("error")
from google.protobuf.unknown_fields import UnknownFieldSet  # noqa: E402
from mcap.exceptions import EndOfFile  # noqa: E402
from mcap.reader import make_reader  # noqa: E402
from mcap.records import (  # noqa: E402
    Attachment, Channel, Footer, Header, Message, Metadata, Schema, Statistics,
)
from mcap.stream_reader import StreamReader  # noqa: E402
from mcap_protobuf.decoder import DecoderFactory  # noqa: E402

MAGIC = b"\x89MCAP0\r\n"


class Fault(Exception):
    """Something that a sound file does not have."""


def value(field, v):
    if field.message_type is not None:
        return fields(v)
    if field.type == field.TYPE_BYTES:
        return v.hex()
    if isinstance(v, float) and not math.isfinite(v):
        return str(v)
    return v


def fields(message):
    """A protobuf message as a dict.  A field that can be unset and is, is left out."""
    if len(UnknownFieldSet(message)):
        raise Fault(f"a {message.DESCRIPTOR.full_name} has fields that its schema does not describe")
    out = {}
    for field in message.DESCRIPTOR.fields:
        if field.has_presence and not message.HasField(field.name):
            continue
        v = getattr(message, field.name)
        if field.message_type is not None and field.message_type.GetOptions().map_entry:
            item = field.message_type.fields_by_name["value"]
            out[field.name] = {str(k): value(item, v[k]) for k in sorted(v)}
        elif isinstance(v, (str, bytes, int, float)) or not hasattr(v, "__len__"):
            out[field.name] = value(field, v)
        else:
            out[field.name] = [value(field, x) for x in v]
    return out


class Decoder:
    def __init__(self):
        self.factory = DecoderFactory()
        self.by_channel = {}

    def __call__(self, schema, channel, message):
        """The data of a message: protobuf as an object, JSON as it is, all else as hex."""
        decode = self.by_channel.get(channel.id)
        if decode is None:
            protobuf = self.factory.decoder_for(channel.message_encoding, schema)
            if protobuf:
                decode = lambda data: fields(protobuf(data))  # noqa: E731
            elif channel.message_encoding == "json":
                decode = json.loads
            else:
                decode = bytes.hex
            self.by_channel[channel.id] = decode
        return decode(message.data)


class Report:
    """Collects the first line while the messages wait in a temporary file."""

    def __init__(self):
        self.decode = Decoder()
        self.counts = Counter()
        self.lines = tempfile.SpooledTemporaryFile(1 << 26, "w+", encoding="utf-8")
        self.file = {}

    def message(self, schema, channel, message):
        self.counts[channel.topic] += 1
        line = {
            "topic": channel.topic,
            "schema": schema.name if schema else None,
            "log_time": message.log_time,
            "publish_time": message.publish_time,
            "sequence": message.sequence,
            "data": self.decode(schema, channel, message),
        }
        self.lines.write(json.dumps(line) + "\n")

    def describe(self, header, statistics, schemas, channels, metadata, attachments):
        self.file.update(
            profile=header.profile if header else None,
            library=header.library if header else None,
            statistics=dict(vars(statistics)) if statistics else None,
            channels=[
                {
                    "id": c.id,
                    "topic": c.topic,
                    "schema": schemas[c.schema_id].name if c.schema_id else None,
                    "schema_encoding": schemas[c.schema_id].encoding if c.schema_id else None,
                    "message_encoding": c.message_encoding,
                    "metadata": c.metadata,
                }
                for c in sorted(channels.values(), key=lambda c: c.id)
            ],
            metadata=[{"name": m.name, "metadata": m.metadata} for m in metadata],
            attachments=[attachment(a) for a in attachments],
        )

    def check_counts(self, statistics):
        by_topic = Counter()
        for c in self.file["channels"]:
            by_topic[c["topic"]] += statistics.channel_message_counts.get(c["id"], 0)
        if +by_topic != +self.counts or statistics.message_count != sum(self.counts.values()):
            raise Fault(f"the statistics count {dict(by_topic)}, read were {dict(self.counts)}")

    def print(self, error):
        # a channel without messages counts 0
        counts = {c["topic"]: 0 for c in self.file.get("channels", [])} | dict(self.counts)
        print(json.dumps(self.file | {"counts": counts, "error": error}))
        self.lines.seek(0)
        for line in self.lines:
            sys.stdout.write(line)
        sys.stdout.flush()
        self.lines.close()


def attachment(a):
    return {
        "name": a.name,
        "media_type": a.media_type,
        "size": len(a.data),
        "sha256": hashlib.sha256(a.data).hexdigest(),
        "log_time": a.log_time,
        "create_time": a.create_time,
    }


def attachment_crc(f, offset):
    """The CRC at the end of an attachment record covers all of it before."""
    f.seek(offset)
    opcode, length = struct.unpack("<BQ", f.read(9))
    body = f.read(length)
    stored = struct.unpack("<I", body[-4:])[0]
    if stored and stored != zlib.crc32(body[:-4]):
        raise Fault(f"the attachment at {offset} has a wrong CRC")


def section_crcs(f, size):
    """The CRCs of the data and summary sections, which the library's index reader skips."""
    f.seek(size - 37)
    opcode, length, summary, _, stored = struct.unpack("<BQQQI", f.read(29))
    if f.read(8) != MAGIC or (opcode, length) != (2, 20):
        return None
    f.seek(0)
    data_end = (summary or size - 37) - 13
    crc, left = 0, data_end
    while left > 0:
        block = f.read(min(left, 1 << 20))
        crc, left = zlib.crc32(block, crc), left - len(block)
    opcode, length, data_stored = struct.unpack("<BQI", f.read(13))
    if (opcode, length) != (15, 4):
        raise Fault("no DataEnd record before the summary")
    if data_stored and data_stored != crc:
        raise Fault("wrong CRC of the data section")
    if stored and summary:
        if zlib.crc32(f.read(size - 37 - summary + 25)) != stored:
            raise Fault("wrong CRC of the summary section")
    return {"data_crc": bool(data_stored), "summary_crc": bool(stored)}


def read_indexed(f, size, report):
    report.file.update(footer=False, summary=False)
    crcs = section_crcs(f, size) if size >= 8 + 37 else None
    if crcs is None:
        raise Fault("the file has no footer: it was not finished (--stream reads what there is)")
    report.file.update(footer=True, **crcs)
    f.seek(0)
    reader = make_reader(f, validate_crcs=True)
    header, summary = reader.get_header(), reader.get_summary()
    if summary is None:
        raise Fault("the file has a footer but no summary (--stream reads what there is)")
    report.file.update(summary=True, chunks=len(summary.chunk_indexes),
                       compression=sorted({c.compression for c in summary.chunk_indexes}))
    report.describe(header, summary.statistics, summary.schemas, summary.channels,
                    list(reader.iter_metadata()), list(reader.iter_attachments()))
    for index in summary.attachment_indexes:
        attachment_crc(f, index.offset)
    statistics = summary.statistics
    if statistics is None:
        raise Fault("the summary has no statistics")
    if statistics.message_count and not summary.chunk_indexes:
        raise Fault("the summary has no chunk index: the messages cannot be found through it")
    for schema, channel, message in reader.iter_messages():
        report.message(schema, channel, message)
    report.check_counts(statistics)
    for name in ("metadata", "attachment"):
        if getattr(statistics, f"{name}_count") != len(getattr(summary, f"{name}_indexes")):
            raise Fault(f"{name} count in the statistics and number of {name} indexes differ")


def last_whole_record(f, size):
    """Offset behind the last record that is all there, and what follows it."""
    at = 8
    while at + 9 <= size:
        f.seek(at)
        opcode, length = struct.unpack("<BQ", f.read(9))
        if opcode == 0:
            return at, "opcode 0"
        if at + 9 + length > size:
            break
        at += 9 + length
        if opcode == 2:
            return at, "footer"
    return at, "end of data" if at == size else "inside a record"


def read_stream(f, size, report):
    if f.seek(0) or f.read(8) != MAGIC:
        raise Fault("the file does not begin as MCAP")
    whole, how = last_whole_record(f, size)
    report.file.update(ended=how, whole=whole, size=size, footer=how == "footer", summary=False)
    f.seek(0)
    header = statistics = fault = None
    schemas, channels, metadata, attachments, records = {}, {}, [], [], Counter()
    try:
        for record in StreamReader(f, validate_crcs=True).records:
            records[type(record).__name__] += 1
            if isinstance(record, Header):
                header = record
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                report.message(schemas[channel.schema_id] if channel.schema_id else None, channel, record)
            elif isinstance(record, Metadata):
                metadata.append(record)
            elif isinstance(record, Attachment):
                attachments.append(record)
            elif isinstance(record, Statistics):
                statistics = record
            elif isinstance(record, Footer):
                report.file["summary"] = record.summary_start != 0
    except Exception as e:  # whatever a half record makes the library do
        error = report.file["reader_error"] = f"{type(e).__name__}: {e}".rstrip(": ")
        # That the data ends is no fault, all that happens before is one
        if not (isinstance(e, EndOfFile) and f.tell() >= whole or how != "end of data" and f.tell() > whole):
            fault = f"the library stopped at or before offset {f.tell()}: {error}"
        if isinstance(e, (Fault, Warning)):
            fault = error
    report.file["records"] = dict(records)
    report.describe(header, statistics, schemas, channels, metadata, attachments)
    if fault:
        raise Fault(fault)
    if how == "opcode 0":
        raise Fault(f"no record at offset {whole}: its opcode is 0")
    if statistics:
        report.check_counts(statistics)


def main():
    args = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    args.add_argument("--stream", action="store_true", help="read record by record, without the index")
    args.add_argument("file")
    args = args.parse_args()
    report, error = Report(), None
    try:
        with open(args.file, "rb") as f:
            size = f.seek(0, io.SEEK_END)
            (read_stream if args.stream else read_indexed)(f, size, report)
    except Exception as e:
        error = str(e) if isinstance(e, Fault) else f"{type(e).__name__}: {e}"
    report.print(error)
    if error:
        print(f"read_mcap.py: {args.file}: {error}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
