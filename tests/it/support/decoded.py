"""Holds every decoded message of a recording against cantools.

    decoded.py RECORDING DBC BUS

Prints how many messages, values and labels were compared.  Any difference ends it with 1.
"""
import json
import math
import sys

import cantools
from types import SimpleNamespace

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory



def frames(batch, time):
    """The frames of a bustape.CanBatch, as docs/file-format.md tells."""
    counts = [list(batch.kind).count(kind) for kind in range(len(batch.kinds))]
    starts, end = [], 0
    for kind, count in zip(batch.kinds, counts):
        starts.append(end)
        end += kind.length * count
    given = [0] * len(batch.kinds)
    for delta, index in zip(batch.delta, batch.kind):
        time += delta * batch.tick_ns
        kind, first = batch.kinds[index], starts[index] + given[index]
        given[index] += 1
        data = bytes(batch.data[first + byte * counts[index]] for byte in range(kind.length))
        yield time, SimpleNamespace(id=kind.id, data=data)


path, dbc, bus = sys.argv[1:]
database = cantools.database.load_file(dbc, strict=False)
raw, decoded, seen = {}, {}, {"messages": 0, "values": 0, "labels": 0}
with open(path, "rb") as file:
    reader = make_reader(file, decoder_factories=[DecoderFactory()])
    for schema, channel, message, value in reader.iter_decoded_messages():
        if schema.name == "bustape.CanBatch":
            raw.update(frames(value, message.log_time))
        elif channel.topic == f"/{bus}/raw":
            raw[message.log_time] = value
        elif channel.metadata.get("protocol"):
            assert message.log_time not in decoded, channel.topic
            decoded[message.log_time] = channel, value


def same(ours, theirs):
    if isinstance(theirs, float) and math.isnan(theirs):
        return math.isnan(ours)
    return ours == theirs or math.isclose(ours, theirs, rel_tol=1e-15)


for time, frame in raw.items():
    try:
        message = database.get_message_by_frame_id(frame.id)
    except KeyError:
        assert time not in decoded, hex(frame.id)
        continue
    theirs = message.decode(frame.data, decode_choices=False, allow_truncated=True)
    plain = message.decode(frame.data, decode_choices=False, scaling=False, allow_truncated=True)
    channel, ours = decoded.pop(time)
    seen["messages"] += 1
    metadata = channel.metadata
    kinds = ours.DESCRIPTOR.fields_by_name
    names = {metadata.get("name." + name, name): name for name in kinds}
    for signal in message.signals:
        name = names[signal.name]
        assert ours.HasField(name) == (signal.name in theirs), (message.name, signal.name, frame)
        if signal.unit:
            assert metadata["unit." + name] == signal.unit
        label = name + "_label"
        if label in names.values() and kinds[label].enum_type and signal.choices:
            number = plain.get(signal.name)
            text = signal.choices.get(number)
            if text is None or not -(1 << 31) <= number < 1 << 31:
                assert not ours.HasField(label), (message.name, signal.name, number)
            else:
                assert getattr(ours, label) == number
                enum = kinds[label].enum_type.values_by_number[number].name
                assert metadata.get(f"label.{name}.{number}", enum) == str(text), (enum, text)
                seen["labels"] += 1
        if signal.name in theirs:
            value = getattr(ours, name)
            assert same(value, theirs[signal.name]), (signal.name, value, theirs[signal.name])
            seen["values"] += 1
assert not decoded, decoded
print(json.dumps(seen))
