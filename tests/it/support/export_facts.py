"""Prints what a Parquet file says of its table, and of the column named."""
import sys

import pyarrow.parquet as pq

schema = pq.read_schema(sys.argv[1])
facts = pq.ParquetFile(sys.argv[1]).metadata.metadata
assert schema.metadata[b"bustape.message"] == facts[b"bustape.message"], schema.metadata
for key, text in facts.items():
    print(f"{key.decode()}={text.decode()}")
for key, text in schema.field(sys.argv[2]).metadata.items():
    print(f"{key.decode()}:{text.decode()}")
