"""The tables with the metadata of LeRobot v3: its tasks and its episodes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from simfoundry.data.formats.lerobot.staging import write_table


def write_tasks_table(instructions: Sequence[str], path: Path) -> None:
    """Write the index of each instruction.

    The instruction is the index in pandas. If it were a column, LeRobot would read numbers in place of instructions
    without an error.
    """
    import pyarrow as pa

    number = {"field_name": "task_index", "name": "task_index", "pandas_type": "int64", "numpy_type": "int64"}
    text = {"field_name": "task", "name": "task", "pandas_type": "unicode", "numpy_type": "object"}
    names = {"name": None, "field_name": None, "pandas_type": "unicode", "numpy_type": "object"}
    pandas = {
        "index_columns": ["task"],
        "column_indexes": [{**names, "metadata": {"encoding": "UTF-8"}}],
        "columns": [{**number, "metadata": None}, {**text, "metadata": None}],
        "pandas_version": "2.0.0",
    }
    kinds = pa.schema([("task_index", pa.int64()), ("task", pa.string())], metadata={"pandas": json.dumps(pandas)})
    columns = [pa.array(range(len(instructions)), pa.int64()), pa.array(list(instructions), pa.string())]
    write_table([pa.table(columns, schema=kinds)], path)


def write_episodes_table(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Write the description of each episode, one row each."""
    import pyarrow as pa

    columns = {name: pa.array([row[name] for row in rows]) for name in rows[0]}
    write_table([pa.table(columns)], path)
