"""Attitude from an inertial sensor: a Kalman filter with sigma and flags."""

from os import PathLike
from typing import Any, Literal, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str

class Attitude:
    """Attitude at one sample: forward, right, down against north, east, down."""

    t_us: int
    quaternion: tuple[float, float, float, float]
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    rates_rad_s: tuple[float, float, float]
    tilt_sigma_rad: float
    bias_rad_s: tuple[float, float, float]
    flags: int
    heading_rad: float | None
    heading_sigma_rad: float | None
    yaw_offset_rad: float | None
    @property
    def is_valid(self) -> bool: ...
    @property
    def is_heading_valid(self) -> bool: ...

class Attitudes:
    """Attitudes of a recording: one row for each sample."""

    t_us: NDArray[np.int64]
    quaternion: NDArray[np.float32]
    euler_rad: NDArray[np.float32]
    rates_rad_s: NDArray[np.float32]
    tilt_sigma_rad: NDArray[np.float32]
    bias_rad_s: NDArray[np.float32]
    flags: NDArray[np.uint32]
    heading_rad: NDArray[np.float32]
    heading_sigma_rad: NDArray[np.float32]
    yaw_offset_rad: NDArray[np.float32]

class Kalman:
    """Kalman filter for the attitude of a body, with the sensor's mount."""

    def __init__(
        self,
        rate_hz: float | None = None,
        *,
        mount: str = "z-up",
        sensor_delay_us: int = 0,
        accelerometer: Literal["factory", "six-poses", "calibrated"] = "calibrated",
        compass: Literal["factory", "hard-iron", "calibrated"] = "factory",
        compass_delay_us: int = 0,
        declination_deg: float = 0.0,
    ) -> None: ...
    def update(
        self, t_us: int, gyro: Any, accel: Any, mag: Any | None = None, *, armed: bool = False
    ) -> Attitude: ...
    def run(
        self,
        t_us: ArrayLike,
        gyro: ArrayLike,
        accel: ArrayLike,
        mag: ArrayLike | None = None,
        *,
        armed: ArrayLike | None = None,
    ) -> Attitudes: ...

class Recording:
    """Recording of a sensor, in its own axes."""

    t_us: NDArray[np.int64]
    accel: NDArray[np.float64]
    gyro: NDArray[np.float64]
    mag: NDArray[np.float64] | None
    truth: NDArray[np.float64]
    scored: NDArray[np.bool_]
    armed: NDArray[np.bool_] | None

class AccelerometerCalibration(TypedDict):
    offset_m_s2: NDArray[np.float32]
    matrix: NDArray[np.float32]
    residual_before_m_s2: float
    residual_after_m_s2: float

def flag_names(flags: int) -> str: ...
def read_log(
    path: str | PathLike[str],
    *,
    time_unit: Literal["us", "ms", "s", "ns"] | None = None,
    force_unit: Literal["m/s2", "g", "mg"] | None = None,
    rate_unit: Literal["rad/s", "deg/s", "mdeg/s"] | None = None,
    field_unit: Literal["uT", "mG", "G", "nT", "T", "norm"] | None = None,
    bad_rows: Literal["refuse", "skip"] | None = None,
) -> Recording: ...
def simulate(
    kind: Literal["flight", "swing", "rest"] = "flight", *, seed: int = 1000, seconds: int = 60
) -> Recording: ...
def calibrate_accelerometer(poses: ArrayLike) -> AccelerometerCalibration: ...
