"""The editor in the browser: it shows a scene or task, and turns each act of a person into an edit of the text.

:mod:`~simfoundry.studio.session` holds the texts and knows nothing of the browser, :mod:`~simfoundry.studio.acts`
contains what people can do, and :mod:`~simfoundry.studio.view` shows the result.
"""
