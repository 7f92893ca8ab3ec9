"""Teleoperation: a person moves the robots of a task with a device, and the rollouts become demonstrations.

Data flows in one direction. A link (:mod:`simfoundry.teleop.links`) receives packets from a device and stamps them with
the time. The device (:mod:`simfoundry.teleop.devices`) turns packets into commands, the
:class:`~simfoundry.teleop.teleoperator.Teleoperator` turns commands into the actions of a policy, and
:mod:`simfoundry.teleop.session` runs rollouts with it. Everything that enters is an event of a stream
(:mod:`simfoundry.teleop.stream`), so a recorded stream repeats a session without the device.
"""
