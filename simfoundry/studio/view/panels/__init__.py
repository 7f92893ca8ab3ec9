"""The panels beside the scene. Each module contains one; :mod:`~simfoundry.studio.view.window` lists them by tab."""
