"""Prints what a Parquet file says of its table, and of the column named."""
import sys

import pyarrow.parquet as pq

schema = pq.read_schema(sys.argv[1])
for key, text in schema.metadata.items():
    print(f"{key.decode()}={text.decode()}")
for key, text in schema.field(sys.argv[2]).metadata.items():
    print(f"{key.decode()}:{text.decode()}")
