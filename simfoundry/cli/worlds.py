"""Option type for the simulator in which to run a scene."""

from __future__ import annotations

import click


class WorldName(click.ParamType):  # type: ignore[type-arg]  # generic only from click 8.4 on; 8.1 is supported
    """Name of a simulator that can run scenes; it is resolved on use, so that ``--help`` loads none."""

    name = "simulator"

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the name if the target has a world."""
        from simfoundry.worlds import is_world, world_names

        if not is_world(value):
            self.fail(f"`{value}` cannot run scenes; available: {', '.join(world_names())}", param, ctx)
        return value
