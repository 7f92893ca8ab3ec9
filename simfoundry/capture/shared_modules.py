"""The modules that a second process imports before it takes over long stages of a reconstruction.

The list contains only what these stages use, so that the process is ready early.
"""

SHARED_MODULES = (
    "scipy.optimize",
    "scipy.spatial",
    "shapely",
    "simfoundry.capture.shapes.fit",
    "cv2",
    "simfoundry.capture.doubts.image_doubts",
    "scipy.ndimage",
    "simfoundry.capture.description.support_object",
    "simfoundry.capture.removal",
    "simfoundry.capture.shapes.texture",
    "simfoundry.capture.outputs.pictures",
)
