"""Attitude from an inertial sensor: a Kalman filter with sigma and flags."""

from os import PathLike
from typing import Any, Final, Literal, TypedDict, overload, type_check_only

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str

# Flags: `attitudes.flags & aplomb.GAP` is not zero where the time had a gap.
CALIBRATING: Final = 0x1
MOVED: Final = 0x2
MISSED: Final = 0x4
GAP: Final = 0x8
TIME: Final = 0x10
GYROSCOPE_SATURATED: Final = 0x20
ACCELEROMETER_SATURATED: Final = 0x40
FREE_FALL: Final = 0x80
FROZEN: Final = 0x100
REJECTED: Final = 0x200
VALID: Final = 0x400
DEGRADED: Final = 0x800
STALE: Final = 0x1000
BUS_FAULT: Final = 0x2000
SENSOR_RESET: Final = 0x4000
LATE: Final = 0x8000
TEMPERATURE: Final = 0x10000
POLLED: Final = 0x20000
INTERNAL_CLOCK: Final = 0x40000
HEADING_VALID: Final = 0x80000
COMPASS_FAULT: Final = 0x100000
VIBRATION: Final = 0x200000

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
    @property
    def is_valid(self) -> NDArray[np.bool_]: ...
    @property
    def is_heading_valid(self) -> NDArray[np.bool_]: ...
    def __len__(self) -> int: ...

class Kalman:
    """Kalman filter for the attitude of a body, with the sensor's mount."""

    def __init__(
        self,
        rate_hz: float | None = None,
        *,
        mount: str = "z-up",
        sensor_delay_us: int = 0,
        accelerometer: Literal["factory", "six-poses", "calibrated"] | None = None,
        gyroscope: Literal["factory", "calibrated"] | None = None,
        compass: Literal["factory", "hard-iron", "calibrated"] = "factory",
        compass_delay_us: int = 0,
        declination_deg: float = 0.0,
    ) -> None: ...
    def update(
        self, t_us: int, gyro: Any, accel: Any, mag: Any | None = None, *, armed: bool = False
    ) -> Attitude: ...
    @overload
    def run(
        self,
        recording: Recording,
        /,
        *,
        mag: ArrayLike | None = None,
        armed: ArrayLike | None = None,
        check_units: bool = True,
    ) -> Attitudes: ...
    @overload
    def run(
        self,
        t_us: ArrayLike,
        gyro: ArrayLike,
        accel: ArrayLike,
        mag: ArrayLike | None = None,
        *,
        armed: ArrayLike | None = None,
        check_units: bool = True,
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
    @property
    def accelerometer(self) -> Literal["factory", "six-poses", "calibrated"] | None: ...
    def __len__(self) -> int: ...

@type_check_only
class _AccelerometerCalibration(TypedDict):
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
def calibrate_accelerometer(poses: ArrayLike) -> _AccelerometerCalibration: ...
