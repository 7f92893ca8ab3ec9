"""A scene as one self-contained HTML page, for pull requests and notebooks."""

from __future__ import annotations

import html
import io
import secrets
from contextlib import redirect_stdout

from simfoundry.runtime.files import MARK
from simfoundry.scene.model import Scene
from simfoundry.studio.guard import ConnectionGuard, guarded
from simfoundry.studio.view.canvas import Canvas, prepare_view
from simfoundry.studio.view.lights import light_nodes, panorama_nodes
from simfoundry.studio.view.nodes import DisplayOptions, object_nodes, scene_nodes
from simfoundry.studio.view.robots import ShownRobots

# Height [px] of a scene in a notebook: as much of a screen as still leaves room for code.
NOTEBOOK_HEIGHT = 480

# What a page shows by default.
PLAIN = DisplayOptions()


def scene_html(scene: Scene, options: DisplayOptions = PLAIN) -> str:
    """Return a page that shows a scene, which can be turned with the mouse. It fetches nothing from elsewhere.

    Equal scenes give equal pages.
    """
    import viser

    nodes = scene_nodes(scene, options)
    if options.lights:
        nodes |= light_nodes(scene, options.shadows) | panorama_nodes(scene)
    robots = ShownRobots()
    robots.read(scene.robots)
    for robot in robots.known(scene.robots):
        nodes |= object_nodes(robot, options, "robots")
    # The page is written by a server, which nobody is to connect to.
    with guarded(ConnectionGuard(secrets.token_urlsafe())), redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            prepare_view(server, scene, bool(scene.robots))
            canvas = Canvas(server.scene)
            canvas.light("/lights/sky" not in nodes, options.shadows)
            canvas.show(nodes)
            page = server.scene.as_html()
        finally:
            server.stop()
    start = page.index(">") + 1  # after the document type
    return f"{page[:start]}\n<!-- {MARK}: {html.escape(scene.name)} -->{page[start:]}"


def notebook_html(scene: Scene) -> str:
    """Return HTML that shows a scene inside of a notebook."""
    page = html.escape(scene_html(scene), quote=True)
    style = f"width:100%;height:{NOTEBOOK_HEIGHT}px;border:0"
    return f'<iframe srcdoc="{page}" style="{style}" sandbox="allow-scripts"></iframe>'
