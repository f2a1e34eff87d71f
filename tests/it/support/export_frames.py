"""Reads raw frames in Parquet with four programs, and compares them with the same frames in CSV.

    export_frames.py PARQUET CSV
"""
import csv, datetime, sys

import duckdb, pandas, polars, pyarrow as pa, pyarrow.parquet as pq

PARQUET, CSV = sys.argv[1:]


def nanos(text):
    moment = datetime.datetime.fromisoformat(text[:19] + "+00:00")
    return int(moment.timestamp()) * 10**9 + int(text[20:29])


def cells(time, bus, id, flags, dlc, data):
    none = lambda value: None if value is None or pandas.isna(value) else int(value)
    return time, bus, none(id), flags, none(dlc), bytes(data).hex().upper()


with open(CSV, newline="") as file:
    empty = lambda text: int(text) if text else None
    want = [(nanos(row["time"]), row["bus"], empty(row["id"]), row["flags"], empty(row["dlc"]), row["data"])
            for row in csv.DictReader(file)]

table = pq.read_table(PARQUET)
words = pa.dictionary(pa.int32(), pa.string())
kinds = [("time", pa.timestamp("ns", tz="UTC")), ("bus", words), ("id", pa.uint32()), ("flags", words),
         ("dlc", pa.uint8()), ("data", pa.binary())]
assert list(zip(table.schema.names, table.schema.types)) == kinds, table.schema
columns = [table["time"].cast("int64").to_pylist(), *(table[name].to_pylist() for name, _ in kinds[1:])]
assert [cells(*row) for row in zip(*columns)] == want

frame = pandas.read_parquet(PARQUET)
assert str(frame["time"].dtype) == "datetime64[ns, UTC]", frame.dtypes
frame["time"] = frame["time"].astype("int64")
assert [cells(*row) for row in frame.itertuples(index=False)] == want

frame = polars.read_parquet(PARQUET).with_columns(polars.col("time").dt.timestamp("ns"))
assert [cells(*row) for row in frame.iter_rows()] == want

rows = duckdb.sql(f"select epoch_ns(time), * exclude (time) from '{PARQUET}'").fetchall()
assert [cells(*row) for row in rows] == want
print(len(want))
