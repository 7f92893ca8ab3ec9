"""RLDS: episodes as TFRecords, with the metadata that TensorFlow Datasets reads. Written without TensorFlow."""

from simfoundry.data.formats.rlds.format import FORMAT

__all__ = ["FORMAT"]
