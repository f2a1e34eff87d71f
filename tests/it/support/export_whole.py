"""Reads a dataset of Parquet as a whole, and compares it with the same tables in CSV.

    export_whole.py READER DATASET CSV

READER is duckdb, polars, pyarrow or pandas. Prints how many tables, rows and values were equal; any
difference is an error.
"""
import csv, datetime, glob, json, os, sys

READER, DATASET, CSV = sys.argv[1:]
GLOB = os.path.join(DATASET, "**", "*.parquet")


def wanted():
    """(bus, message) -> rows of the CSV files"""
    tables = {}
    for path in glob.glob(os.path.join(CSV, "*", "*.csv")):
        bus, name = path.split(os.sep)[-2:]
        with open(path, newline="") as file:
            tables[bus, name.removesuffix(".csv")] = list(csv.DictReader(file))
    return tables


def duckdb_rows():
    import duckdb
    source = f"read_parquet('{GLOB}', hive_partitioning = true, union_by_name = true)"
    query = f"select epoch_ns(time) as time_ns, * exclude (time) from {source}"
    result = duckdb.connect().execute(query)
    names = [column[0] for column in result.description]
    for row in result.fetchall():
        row = dict(zip(names, row))
        yield row.pop("bus"), row.pop("message"), row.pop("time_ns"), row


def polars_rows():
    import polars
    files = [polars.scan_parquet(path, hive_partitioning=True) for path in sorted(glob.glob(GLOB, recursive=True))]
    whole = polars.concat(files, how="diagonal_relaxed").collect()
    times = whole["time"].dt.timestamp("ns").to_list()
    for time, row in zip(times, whole.drop("time").iter_rows(named=True)):
        yield row.pop("bus"), row.pop("message"), time, row


def pyarrow_rows():
    import pyarrow as pa, pyarrow.dataset as ds
    whole = ds.dataset(DATASET, partitioning="hive")
    schemas = [whole.schema, *(fragment.physical_schema for fragment in whole.get_fragments())]
    schema = pa.unify_schemas(schemas, promote_options="permissive")
    table = ds.dataset(DATASET, partitioning="hive", schema=schema).to_table()
    times = table["time"].cast("int64").to_pylist()
    for time, row in zip(times, table.drop(["time"]).to_pylist()):
        yield row.pop("bus"), row.pop("message"), time, row


def pandas_rows():
    import pandas
    for path in glob.glob(os.path.join(DATASET, "*", "*")):
        bus, message = (part.split("=", 1)[1] for part in path.split(os.sep)[-2:])
        frame = pandas.read_parquet(path)
        times = frame.pop("time").astype("int64").tolist()
        for time, row in zip(times, frame.to_dict("records")):
            yield bus, message, time, {name: None if pandas.isna(v) else v for name, v in row.items()}


def nanos(text):
    moment = datetime.datetime.fromisoformat(text[:19] + "+00:00")
    return int(moment.timestamp()) * 10**9 + int(text[20:29])


def same(found, text):
    if isinstance(found, (bytes, bytearray)):
        return found.hex().upper() == text
    if isinstance(found, str):
        # A column that is a number in one message and a text in another is read as text.
        return found == text or number(found) is not None and number(found) == number(text)
    single = abs(float(found) - float(text)) <= 1e-7 * abs(float(text))
    return float(found) == float(text) or single or str(float(found)) == str(float(text))


def number(text):
    try:
        return float(text)
    except ValueError:
        return None


def main():
    tables = {}
    for bus, message, time, row in globals()[READER + "_rows"]():
        row = {name: value for name, value in row.items() if value is not None}
        tables.setdefault((bus, message), []).append((time, row))
    want = wanted()
    assert set(tables) == set(want), set(tables) ^ set(want)
    rows = values = 0
    for name, found in tables.items():
        assert len(found) == len(want[name]), name
        for (time, row), texts in zip(found, want[name]):
            assert time == nanos(texts.pop("time")), (name, time)
            texts = {key: text for key, text in texts.items() if text != "" or row.get(key) in ("", b"")}
            assert set(row) == set(texts), (name, set(row) ^ set(texts))
            for key, text in texts.items():
                assert same(row[key], text), (name, time, key, row[key], text)
                values += 1
            rows += 1
    print(json.dumps({"tables": len(tables), "rows": rows, "values": values}))


main()
