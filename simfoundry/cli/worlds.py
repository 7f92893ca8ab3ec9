"""The option value that names a simulator to run a scene in."""

from __future__ import annotations

import click


class WorldName(click.ParamType):  # type: ignore[type-arg]  # generic from click 8.4 on, and 8.1 will do
    """A simulator that scenes can be run in; it is looked up when it is given, so that ``--help`` loads none."""

    name = "simulator"

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the name, if a target of that name has a world."""
        from simfoundry.worlds import is_world, world_names

        if not is_world(value):
            self.fail(f"scenes cannot be run in `{value}`; the simulators are: {', '.join(world_names())}", param, ctx)
        return value
