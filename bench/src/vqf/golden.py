"""Writes golden.csv: VQF of its authors on the signal of tests.rs.

pip install vqf==2.1.2 numpy; python golden.py > golden.csv
"""

import numpy as np
from vqf import VQF

SECONDS = 280
NOTED_S = 10
SMALL_BIAS_DEG_S = (0.5, -0.7, 0.3)
LARGE_BIAS_DEG_S = (4.0, -3.0, 1.0)
# Step of the samples in µs, samples for each reading of the field, and bias.
CASES = [(10_000, 1, SMALL_BIAS_DEG_S), (3_500, 3, SMALL_BIAS_DEG_S),
         (1_000, 10, SMALL_BIAS_DEG_S), (3_500, 3, LARGE_BIAS_DEG_S),
         (1_000, 10, LARGE_BIAS_DEG_S)]
DISTURBANCE_UT = (15.0, -10.0, 8.0)


def envelope(t):
    """Strength of the motion and its derivative: rest, motion, rest, motion."""
    for start, end in ((6.0, 30.0), (42.0, 290.0)):
        if start <= t < end:
            omega = np.pi / 6.0
            if t < start + 3.0:
                phase = omega * (t - start)
            elif t >= end - 3.0:
                phase = omega * (end - t)
                omega = -omega
            else:
                return 1.0, 0.0
            return np.sin(phase) ** 2, omega * np.sin(2.0 * phase)
    return 0.0, 0.0


def angle(t, offset, size, frequency):
    strength, growth = envelope(t)
    sine, cosine = np.sin(frequency * t), np.cos(frequency * t)
    return (offset + size * strength * sine,
            size * (growth * sine + strength * frequency * cosine))


def turned(first, second, angle_rad):
    """Two coordinates after a turn from the first to the second."""
    sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
    return cosine * first - sine * second, sine * first + cosine * second


def earth_field(t):
    """Field in east, north, up, µT."""
    field = np.array([1.0, 20.0, -44.0])
    if 22.0 <= t < 26.0 or t >= 50.0:
        field = field + DISTURBANCE_UT
    scale, turn, tip = 1.0, 0.0, 0.0
    if 85.0 <= t < 91.0:
        turn, tip = 0.3, 0.26
    elif 91.0 <= t < 160.0:
        turn = 0.3
    if t >= 91.0:
        scale += 0.006 * min(t - 91.0, 40.0)
    if 165.0 <= t < 205.0 or 215.0 <= t < 270.0:
        turn = 0.5
        scale *= 1.5 if int(t / 3.0) % 2 == 0 else 0.7
    east, north, up = field
    north, up = turned(north, up, tip)
    east, north = turned(east, north, turn)
    return scale * np.array([east, north, up])


def signal(t, bias_deg_s):
    """Rate in rad/s, specific force in m/s² and field in µT, in sensor axes."""
    roll, roll_rate = angle(t, 0.3, 0.9, 1.3)
    pitch, pitch_rate = angle(t, -0.2, 0.6, 1.7)
    yaw, yaw_rate = angle(t, 0.7, 1.5, 0.7)
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    sy, cy = np.sin(yaw), np.cos(yaw)
    rate = np.array([roll_rate - yaw_rate * sp,
                     pitch_rate * cr + yaw_rate * cp * sr,
                     yaw_rate * cp * cr - pitch_rate * sr]) + np.radians(bias_deg_s)
    to_earth = np.array([[cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                         [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                         [-sp, cp * sr, cp * cr]])
    strength, _ = envelope(t)
    force = np.array([3.0 * strength * np.sin(2.1 * t),
                      2.0 * strength * np.sin(1.9 * t + 1.0),
                      9.81 + strength * np.sin(2.7 * t)])
    if 30.0 <= t < 36.0:
        force[0] += 0.55 * np.sin(30.0 * t)
    return rate, to_earth.T @ force, to_earth.T @ earth_field(t)


def main():
    print("step_us,index,w6,x6,y6,z6,w9,x9,y9,z9,bias_x_rad_s,bias_y_rad_s,bias_z_rad_s")
    for step_us, samples_a_field, bias_deg_s in CASES:
        step_s = step_us * 1e-6
        filter = VQF(step_s, step_s, step_s * samples_a_field)
        noted = NOTED_S * 1_000_000 // step_us
        for index in range(1, SECONDS * 1_000_000 // step_us + 1):
            rate, force, field = signal(index * step_s, bias_deg_s)
            filter.updateGyr(rate)
            filter.updateAcc(force)
            if index % samples_a_field == 0:
                filter.updateMag(field)
            if index % noted == 0:
                row = [*filter.getQuat6D(), *filter.getQuat9D(), *filter.getBiasEstimate()[0]]
                numbers = ",".join(f"{number:.12f}" for number in row)
                print(f"{step_us},{index},{numbers}")


if __name__ == "__main__":
    main()
