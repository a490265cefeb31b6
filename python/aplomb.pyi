"""Attitude from an inertial sensor: a Kalman filter with sigma and flags."""

from os import PathLike
from typing import Any, Literal, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str

class Attitude:
    """Attitude at one sample: forward, right, down against north, east, down."""

    @property
    def t_us(self) -> int: ...
    @property
    def quaternion(self) -> tuple[float, float, float, float]: ...
    @property
    def roll_rad(self) -> float: ...
    @property
    def pitch_rad(self) -> float: ...
    @property
    def yaw_rad(self) -> float: ...
    @property
    def rates_rad_s(self) -> tuple[float, float, float]: ...
    @property
    def tilt_sigma_rad(self) -> float: ...
    @property
    def bias_rad_s(self) -> tuple[float, float, float]: ...
    @property
    def flags(self) -> int: ...
    @property
    def heading_rad(self) -> float | None: ...
    @property
    def heading_sigma_rad(self) -> float | None: ...
    @property
    def yaw_offset_rad(self) -> float | None: ...
    @property
    def is_valid(self) -> bool: ...
    @property
    def is_heading_valid(self) -> bool: ...

class Attitudes:
    """Attitudes of a recording: one row for each sample."""

    @property
    def t_us(self) -> NDArray[np.int64]: ...
    @property
    def quaternion(self) -> NDArray[np.float32]: ...
    @property
    def euler_rad(self) -> NDArray[np.float32]: ...
    @property
    def rates_rad_s(self) -> NDArray[np.float32]: ...
    @property
    def tilt_sigma_rad(self) -> NDArray[np.float32]: ...
    @property
    def bias_rad_s(self) -> NDArray[np.float32]: ...
    @property
    def flags(self) -> NDArray[np.uint32]: ...
    @property
    def heading_rad(self) -> NDArray[np.float32]: ...
    @property
    def heading_sigma_rad(self) -> NDArray[np.float32]: ...
    @property
    def yaw_offset_rad(self) -> NDArray[np.float32]: ...

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

    @property
    def t_us(self) -> NDArray[np.int64]: ...
    @property
    def accel(self) -> NDArray[np.float64]: ...
    @property
    def gyro(self) -> NDArray[np.float64]: ...
    @property
    def mag(self) -> NDArray[np.float64] | None: ...
    @property
    def truth(self) -> NDArray[np.float64]: ...
    @property
    def scored(self) -> NDArray[np.bool_]: ...
    @property
    def armed(self) -> NDArray[np.bool_] | None: ...

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
