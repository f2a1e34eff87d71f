"""Compares an export with what cantools decodes from the same log.

    export_check.py DBC LOG KIND PATH [ARGUMENT]

KIND is pyarrow, unified, pandas, duckdb, polars, csv, jsonl, influx (line protocol, parsed to JSON),
long or wide. Prints how many rows and
values were equal; any difference is an error.
"""
import csv, json, math, os, re, struct, sys

import cantools

DBC, LOG, KIND, PATH = sys.argv[1:5]
MORE = sys.argv[5:]


def expected():
    """message -> [(time in ns, {signal: value}, {signal: label})]"""
    db = cantools.database.load_file(DBC, strict=False)
    by = {(m.frame_id, m.is_extended_frame): m for m in db.messages}
    rows = {}
    for line in open(LOG):
        found = re.fullmatch(r"\((\d+)\.(\d+)\) \S+ ([0-9A-F]+)#((?:[0-9A-F]{2})*)", line.strip())
        if not found:
            continue
        seconds, fraction, id, data = found.groups()
        time = int(seconds) * 10**9 + int(fraction.ljust(9, "0"))
        message = by.get((int(id, 16), len(id) == 8))
        if message is None:
            continue
        data = bytes.fromhex(data)
        options = dict(decode_choices=False, allow_truncated=True)
        values = message.decode(data, **options)
        raws = message.decode(data, scaling=False, **options)
        choices = {s.name: s.choices for s in message.signals if s.choices}
        labels = {n: str(choices[n][r]) for n, r in raws.items() if n in choices and r in choices[n]}
        rows.setdefault(message.name, []).append((time, values, labels))
    return rows


def is_absent(value):
    return value is None or value == ""


def same(a, b):
    a, b = float(a), float(b)
    return a == b or (math.isnan(a) and math.isnan(b)) or \
        struct.pack("<f", a) == struct.pack("<f", b) and abs(a - b) <= abs(b) * 1e-7


COUNT = [0, 0]


def compare(message, wanted, found):
    """found: [(time in ns, {column: value})], absent ones None or left out"""
    assert len(wanted) == len(found), (message, len(wanted), len(found))
    for (time, values, labels), (at, row) in zip(wanted, found):
        assert time == at, (message, time, at)
        row = {name: value for name, value in row.items() if not is_absent(value)}
        want = set(values) | {name + "_label" for name in labels}
        assert set(row) == want, (message, time, set(row) ^ want)
        for name, value in values.items():
            assert same(row[name], value), (message, time, name, row[name], value)
            COUNT[1] += 1
        for name, text in labels.items():
            assert row[name + "_label"] == text, (message, name, row[name + "_label"], text)
        COUNT[0] += 1


def folders():
    for bus in os.listdir(PATH):
        for message in os.listdir(os.path.join(PATH, bus)):
            yield message.split("=")[1], os.path.join(PATH, bus, message)


def arrow_rows(table):
    columns = [(n, table[n].to_pylist()) for n in table.column_names if n != "time"]
    times = table["time"].cast("int64").to_pylist()
    return [(t, {n: c[i] for n, c in columns}) for i, t in enumerate(times)]


def main():
    want = expected()
    seen = set()
    if KIND == "pyarrow":
        import pyarrow as pa, pyarrow.dataset as ds, pyarrow.parquet as pq
        for message, path in folders():
            table = ds.dataset(path).to_table()
            assert table.schema.field("time").type == pa.timestamp("ns", tz="UTC"), table.schema
            compare(message, want[message], arrow_rows(table))
            seen.add(message)
            for part in os.listdir(path):
                meta = pq.ParquetFile(os.path.join(path, part)).metadata
                for group in range(meta.num_row_groups):
                    for column in range(meta.num_columns):
                        chunk = meta.row_group(group).column(column)
                        assert chunk.compression == "ZSTD", chunk
                        assert chunk.statistics is not None, chunk
                for column, kind in (pair.split("=", 1) for pair in MORE):
                    if column in table.column_names:
                        assert str(table.schema.field(column).type) == kind, table.schema
    elif KIND == "unified":
        import pyarrow as pa, pyarrow.dataset as ds
        first = ds.dataset(PATH, partitioning="hive")
        schemas = [fragment.physical_schema for fragment in first.get_fragments()]
        schema = pa.unify_schemas([first.schema, *schemas], promote_options="permissive")
        whole = ds.dataset(PATH, partitioning="hive", schema=schema)
        for message in want:
            table = whole.to_table(filter=ds.field("message") == message)
            assert set(table["bus"].to_pylist()) == {"can0"}
            compare(message, want[message], arrow_rows(table.drop(["bus", "message"])))
            seen.add(message)
    elif KIND == "pandas":
        import pandas
        for message, path in folders():
            frame = pandas.read_parquet(path)
            assert str(frame["time"].dtype) == "datetime64[ns, UTC]", frame.dtypes
            times = frame.pop("time").astype("int64").tolist()
            rows = [{n: None if pandas.isna(v) else v for n, v in row.items()}
                    for row in frame.to_dict("records")]
            compare(message, want[message], list(zip(times, rows)))
            seen.add(message)
    elif KIND == "duckdb":
        import duckdb
        con = duckdb.connect()
        source = f"read_parquet('{PATH}/**/*.parquet', hive_partitioning=true, union_by_name=true)"
        for message in want:
            query = f"select epoch_ns(time) as t, * exclude (time, bus, message) from {source} " \
                    f"where bus='can0' and message='{message}' order by t"
            result = con.execute(query)
            names = [column[0] for column in result.description]
            rows = [dict(zip(names, row)) for row in result.fetchall()]
            compare(message, want[message], [(row.pop("t"), row) for row in rows])
            seen.add(message)
    elif KIND == "polars":
        import polars
        for message, path in folders():
            frame = polars.read_parquet(os.path.join(path, "*.parquet"), hive_partitioning=False)
            assert frame.schema["time"] == polars.Datetime("ns", "UTC"), frame.schema
            times = frame["time"].dt.timestamp("ns").to_list()
            compare(message, want[message], list(zip(times, frame.drop("time").to_dicts())))
            seen.add(message)
    elif KIND == "csv":
        units = json.loads(MORE[0]) if MORE else {}
        for name in os.listdir(os.path.join(PATH, "can0")):
            message = name.removesuffix(".csv")
            with open(os.path.join(PATH, "can0", name), newline="") as file:
                rows = list(csv.DictReader(file))
            rows = [{units.get(k, k): v for k, v in row.items()} for row in rows]
            compare(message, want[message], [(nanos(row.pop("time")), row) for row in rows])
            seen.add(message)
    elif KIND == "jsonl":
        found = {}
        for line in open(PATH):
            row = json.loads(line)
            cells = row["signals"] | {name + "_label": text for name, text in row["labels"].items()}
            found.setdefault(row["message"], []).append((nanos(row["time"]), cells))
        for message, rows in found.items():
            compare(message, want[message], rows)
            seen.add(message)
    elif KIND == "influx":
        found = {}
        for line in map(json.loads, open(PATH)):
            assert line["tags"] == {"bus": "can0"}, line
            found.setdefault(line["measurement"], []).append((line["time"], line["fields"]))
        for message, rows in found.items():
            compare(message, want[message], rows)
            seen.add(message)
    elif KIND == "long":
        found = {}
        import pyarrow.parquet as pq
        rows = list(csv.DictReader(open(PATH, newline=""))) if PATH.endswith(".csv") else None
        if rows is None:
            table = pq.read_table(PATH)
            rows = table.drop(["time"]).to_pylist()
            for row, time in zip(rows, table["time"].cast("int64").to_pylist()):
                row["time"] = time
        for row in rows:
            time = row["time"] if isinstance(row["time"], int) else nanos(row["time"])
            of = found.setdefault(row["message"], [])
            if not of or of[-1][0] != time:
                of.append((time, {}))
            of[-1][1][row["signal"]] = row["value"]
            if row["label"]:
                of[-1][1][row["signal"] + "_label"] = row["label"]
        for message, rows in found.items():
            compare(message, want[message], rows)
            seen.add(message)
    elif KIND == "wide":
        return wide(want)
    assert seen == set(want), seen ^ set(want)
    print(json.dumps({"rows": COUNT[0], "values": COUNT[1]}))


def nanos(text):
    if re.fullmatch(r"\d+\.\d{9}", text):
        return int(text.replace(".", ""))
    import datetime
    found = re.fullmatch(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)\.(\d{9})Z", text)
    moment = datetime.datetime.fromisoformat(found[1] + "+00:00")
    return int(moment.timestamp()) * 10**9 + int(found[2])


def wide(want):
    import pandas
    fill = MORE[0]
    table = pandas.read_parquet(PATH).set_index("time")
    count = 0
    for message, rows in want.items():
        index = pandas.to_datetime([time for time, _, _ in rows], utc=True)
        values = pandas.DataFrame([v for _, v, _ in rows], index=index).astype("float64")
        steps = values.resample("100ms")
        steps = steps.mean() if fill == "mean" else steps.last()
        steps = steps.reindex(table.index)
        if fill == "hold":
            steps = steps.ffill()
        for signal in values:
            found = table[f"can0.{message}.{signal}"].astype("float64")
            close = ((found - steps[signal]).abs() <= 1e-9 * (1 + steps[signal].abs()))
            equal = close | (found.isna() & steps[signal].isna())
            assert equal.all(), (message, signal, found[~equal], steps[signal][~equal])
            count += len(found)
    print(json.dumps({"rows": len(table), "values": count}))


main()
