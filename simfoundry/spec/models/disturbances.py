"""The section `disturbances` of a task: latency and noise between a policy, the robots and the sensors."""

from typing import Annotated

from pydantic import Field

from simfoundry.spec.models.base import Fraction, Model

# Maximum latency [s]. A policy that reacts later than this to what it sees cannot control an arm.
MAX_LATENCY = 2.0

# Maximum standard deviation of positions [m], joint positions [rad or m], rotations [deg] and exposures [stops]; larger
# values would leave nothing of the signal.
MAX_SHIFT, MAX_JOINT, MAX_TURN_DEG, MAX_STOPS = 1.0, 1.0, 90.0, 8.0

Latency = Annotated[float, Field(ge=0, le=MAX_LATENCY, allow_inf_nan=False)]
JointNoise = Annotated[float, Field(ge=0, le=MAX_JOINT, allow_inf_nan=False)]
PositionNoise = Annotated[float, Field(ge=0, le=MAX_SHIFT, allow_inf_nan=False)]
RotationNoise = Annotated[float, Field(ge=0, le=MAX_TURN_DEG, allow_inf_nan=False)]


class ActionDisturbances(Model):
    """Latency and noise between the actions of a policy and the targets of the robots' joints."""

    latency: Latency = Field(0.0, description="Time from the start of an action to its effect on the targets [s].")
    joint_noise: JointNoise = Field(
        0.0,
        description="Standard deviation of the error of each arm joint's target, drawn for each action [rad or m]. "
        "Errors do not add up.",
    )
    gripper_noise: Fraction = Field(
        0.0, description="Standard deviation of the error of a gripper's target, drawn for each action, from 0 to 1."
    )


class ObservationDisturbances(Model):
    """Latency and noise of what a policy observes. Standard deviations are those of each value in each observation."""

    latency: Latency = Field(0.0, description="Age of the states of robots and objects when they are observed [s].")
    image_latency: Latency | None = Field(
        None, description="Age of images when they are observed [s]; default: `latency`."
    )
    joint_noise: JointNoise = Field(
        0.0, description="Standard deviation of the positions of the robots' joints [rad or m]."
    )
    gripper_noise: Fraction = Field(0.0, description="Standard deviation of the grippers' positions, from 0 to 1.")
    hand_noise: PositionNoise = Field(
        0.0, description="Standard deviation of the positions of the robots' hands, along each axis [m]."
    )
    hand_noise_deg: RotationNoise = Field(
        0.0, description="Standard deviation of the rotations of the robots' hands, about each axis [deg]."
    )
    object_noise: PositionNoise = Field(
        0.0, description="Standard deviation of the positions of objects, along each axis [m]."
    )
    object_noise_deg: RotationNoise = Field(
        0.0, description="Standard deviation of the rotations of objects, about each axis [deg]."
    )
    object_joint_noise: JointNoise = Field(
        0.0, description="Standard deviation of the positions of the objects' joints [rad or m]."
    )
    image_noise: Fraction = Field(
        0.0, description="Standard deviation of the red, green and blue values of each pixel; 1 is the full range."
    )
    exposure: Annotated[float, Field(ge=-MAX_STOPS, le=MAX_STOPS, allow_inf_nan=False)] = Field(
        0.0, description="Exposure of images [stops]; at 1, twice as much light reaches the sensor."
    )
    exposure_noise: Annotated[float, Field(ge=0, le=MAX_STOPS, allow_inf_nan=False)] = Field(
        0.0, description="Standard deviation of the exposure of each camera, drawn once per rollout [stops]."
    )
    depth_noise: PositionNoise = Field(
        0.0,
        description="Standard deviation of the depth at a distance of 1 m [m]. It grows with the square of the "
        "distance, as for stereo cameras.",
    )
    depth_dropout: Fraction = Field(0.0, description="Share of the pixels of a depth image without a value.")


class Disturbances(Model):
    """Latency and noise of actions and observations, which the seed of a rollout determines."""

    action: ActionDisturbances = Field(
        ActionDisturbances.model_construct(), description="Latency and noise of the robots' targets."
    )
    observation: ObservationDisturbances = Field(
        ObservationDisturbances.model_construct(), description="Latency and noise of what the policy observes."
    )
