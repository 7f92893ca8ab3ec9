"""The view of a session in the browser: the nodes of the scene, and the panels beside it.

:mod:`~simfoundry.studio.view.nodes` says what is shown, as data; :mod:`~simfoundry.studio.view.canvas` sends only what
changed; :mod:`~simfoundry.studio.view.window` connects both, and the panels, to the session.
"""
