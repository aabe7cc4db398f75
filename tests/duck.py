#!/usr/bin/env python3
"""Reads results that workers wrote as Parquet with DuckDB: prints structure, mode, intervals and mean frequency of each, as lines of CSV.

    python3 tests/duck.py FOLDER

The query is that of docs/fleet.md, but for the deviation.
"""

import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).parent))
import environment  # noqa: E402

environment.enter(pathlib.Path(__file__).parent.parent / "target" / "duckdb", ["duckdb==1.4.2"])
import duckdb  # noqa: E402

query = f"""
SELECT structure, mode, count(*), avg(frequency_hz)
FROM '{sys.argv[1]}/*/*.parquet' WHERE mode > 0 GROUP BY ALL ORDER BY ALL
"""
for structure, mode, count, mean_hz in duckdb.sql(query).fetchall():
    print(f"{structure},{mode},{count},{mean_hz!r}")
