/* aplomb: attitude from an MPU-6050, or from samples in SI units. docs/c.md explains it.
 *
 *     AplombSettings settings = aplomb_default_settings();
 *     aplomb_init(&pipeline, &settings);                     once
 *     aplomb_update_burst(&pipeline, &burst, &snapshot);     with each burst of 14 bytes
 *
 * Made from c/src/ by `APLOMB_BLESS=1 cargo test -r -p aplomb-c --test header`. */

#ifndef APLOMB_H
#define APLOMB_H

#include <stdbool.h>
#include <stdint.h>

/* Version of this header. `aplomb_version` returns that of the library. */
#define APLOMB_VERSION_MAJOR 0
#define APLOMB_VERSION_MINOR 1
#define APLOMB_VERSION_PATCH 0
#define APLOMB_VERSION "0.1.0"

// The gyroscope's offset is not known. The reported sigma is much larger.
#define APLOMB_FLAG_CALIBRATING (1u << 0)

// The sensor moved before its offset was known.
#define APLOMB_FLAG_MOVED (1u << 1)

// Samples before this one were lost.
#define APLOMB_FLAG_MISSED (1u << 2)

// No sample came for more than half a second. Roll and pitch restarted from gravity. A shorter
// pause of more than 3.5 sample periods has no flag of its own. Its sigma grows: after 61 ms in
// flight, the attitude may be `APLOMB_FLAG_DEGRADED` for 13 s (docs/faults.md).
#define APLOMB_FLAG_GAP (1u << 3)

// The sample's time is not after the previous one. The attitude is held.
#define APLOMB_FLAG_TIME (1u << 4)

// A gyroscope axis reads full scale.
#define APLOMB_FLAG_GYROSCOPE_SATURATED (1u << 5)

// An accelerometer axis reads full scale.
#define APLOMB_FLAG_ACCELEROMETER_SATURATED (1u << 6)

// The specific force is too small to show where down is.
#define APLOMB_FLAG_FREE_FALL (1u << 7)

// The data repeat to the last bit: the sensor sleeps, or the bus or an axis is stuck. The attitude
// is held.
#define APLOMB_FLAG_FROZEN (1u << 8)

// The sample was not a measurement and was ignored.
#define APLOMB_FLAG_REJECTED (1u << 9)

// The tilt is wrong by no more than the larger of 5 degrees and six sigma.
#define APLOMB_FLAG_VALID (1u << 10)

// The attitude is less certain than usual.
#define APLOMB_FLAG_DEGRADED (1u << 11)

// No sample came: the attitude is the last one, and its sigma grows.
#define APLOMB_FLAG_STALE (1u << 12)

// Bursts have failed since the previous sample. The caller reports it, as the next five.
#define APLOMB_FLAG_BUS_FAULT (1u << 13)

// The sensor had lost its settings, and has been configured again.
#define APLOMB_FLAG_SENSOR_RESET (1u << 14)

// A sample was lost because the previous one was still being processed.
#define APLOMB_FLAG_LATE (1u << 15)

// The die is outside -40 to 85 degrees Celsius.
#define APLOMB_FLAG_TEMPERATURE (1u << 16)

// Samples are polled: their time is uncertain by one period.
#define APLOMB_FLAG_POLLED (1u << 17)

// Times are those of an internal oscillator, accurate to 8 %. The attitude goes by the sensor's
// clock, so the time of a burst has to be that of its edge, unless it was polled.
#define APLOMB_FLAG_INTERNAL_CLOCK (1u << 18)

// The heading is wrong by no more than the larger of 15 degrees and six sigma.
#define APLOMB_FLAG_HEADING_VALID (1u << 19)

// The compass gives no usable readings. The caller reports it. The attitude does not depend on it.
#define APLOMB_FLAG_COMPASS_FAULT (1u << 20)

// Vibration is so strong that the accelerometer may clip: the tilt can be wrong by degrees.
#define APLOMB_FLAG_VIBRATION (1u << 21)

// The full scales have been read back since the previous burst or sample, and are right. The
// caller reports it. No attitude has this flag.
#define APLOMB_FLAG_SCALES_VERIFIED (1u << 31)

// Bytes of a state to go on from.
#define APLOMB_WARM_START_BYTES 64

// Bytes of a record.
#define APLOMB_RECORD_BYTES 512

// Largest number of registers that are read together.
#define APLOMB_CHECK_BYTES 5

// Size of a pipeline, in units of eight bytes. The same on every target.
#define APLOMB_PIPELINE_WORDS 320

// Size of a pipeline with a compass, in units of eight bytes. The same on every target.
#define APLOMB_COMPASS_PIPELINE_WORDS 480

// Result of a function. `aplomb_status_text` describes it.
typedef enum AplombStatus {
  // Done.
  APLOMB_STATUS_OK = 0,
  // A pointer is null.
  APLOMB_STATUS_NULL_POINTER = 1,
  // The memory holds no pipeline of this program: call `aplomb_init` first.
  APLOMB_STATUS_NOT_INITIALISED = 2,
  // The mount is no name such as "+x-z", "z-up" or "z-down".
  APLOMB_STATUS_WRONG_MOUNT = 3,
  // The ranges are 2, 4, 8 or 16 g, and 250, 500, 1000 or 2000 degrees per second.
  APLOMB_STATUS_WRONG_RANGE = 4,
  // The low-pass filters are 256, 188, 98, 42, 20, 10 and 5 Hz.
  APLOMB_STATUS_WRONG_LOW_PASS = 5,
  // No part of the family answers WHO_AM_I like this. Begin with `aplomb_default_settings`.
  APLOMB_STATUS_UNKNOWN_PART = 6,
  // No more steps or checks: the list is complete.
  APLOMB_STATUS_NO_MORE_STEPS = 7,
  // The bytes hold no whole record or state, or one of another version.
  APLOMB_STATUS_NO_RECORD = 8,
  // A number of the calibration is not finite.
  APLOMB_STATUS_NOT_STORABLE = 9,
  // The knowledge of the accelerometer or of the compass is none of its values.
  APLOMB_STATUS_WRONG_KNOWLEDGE = 10,
  // The declination is no angle from -pi to pi.
  APLOMB_STATUS_WRONG_DECLINATION = 11,
  // The offset of the accelerometer exceeds 0.2 g, or its matrix is more than 0.1 from the
  // identity.
  APLOMB_STATUS_WRONG_ACCELEROMETER = 12,
  // The offset of the gyroscope exceeds 41 degrees per second. It is in rad/s.
  APLOMB_STATUS_WRONG_GYROSCOPE_OFFSET = 13,
  // The gyroscope's matrix is more than 0.1 from the identity.
  APLOMB_STATUS_WRONG_GYROSCOPE_MATRIX = 14,
  // The level is no unit quaternion, or tilts by more than 15 degrees.
  APLOMB_STATUS_WRONG_LEVEL = 15,
  // The sensor's delay exceeds a tenth of a second.
  APLOMB_STATUS_WRONG_DELAY = 16,
  // The temperature model gives an offset above 41 degrees per second. It is in rad/s.
  APLOMB_STATUS_WRONG_TEMPERATURE_OFFSET = 17,
  // The temperature model's reference is not between its coldest and its warmest temperature, or
  // no part can report one of them.
  APLOMB_STATUS_WRONG_TEMPERATURE_RANGE = 18,
  // The time is before that of the last sample. A clock of 32 bits has wrapped.
  APLOMB_STATUS_WRONG_TIME = 19,
  // The compass's matrix is no correction: its mean gain is 0.1 to 10. All nine numbers
  // are needed: 1, 0, 0, 0, 1, 0, 0, 0, 1 for hard iron alone.
  APLOMB_STATUS_WRONG_COMPASS = 20,
  // No compass gives this field, or the reading is older than a second: an age below zero has
  // wrapped.
  APLOMB_STATUS_WRONG_FIELD = 21,
  // No rest has measured the gyroscope's offset yet: there is no state to go on from.
  APLOMB_STATUS_NO_STATE = 22,
} AplombStatus;

// Knowledge of the accelerometer's offset.
typedef enum AplombAccelerometerKnowledge {
  // As the calibration says.
  APLOMB_ACCELEROMETER_KNOWLEDGE_BY_CALIBRATION = 0,
  // A sensor as it left the factory.
  APLOMB_ACCELEROMETER_KNOWLEDGE_FACTORY = 1,
  // Calibrated on six sides.
  APLOMB_ACCELEROMETER_KNOWLEDGE_SIX_POSES = 2,
  // Calibrated with cross-axis terms. Implies a calibrated gyroscope.
  APLOMB_ACCELEROMETER_KNOWLEDGE_CALIBRATED = 3,
} AplombAccelerometerKnowledge;

// Knowledge of the compass's hard iron.
typedef enum AplombCompassKnowledge {
  // As the calibration says.
  APLOMB_COMPASS_KNOWLEDGE_BY_CALIBRATION = 0,
  // A compass that was never calibrated: no heading before the body has turned.
  APLOMB_COMPASS_KNOWLEDGE_FACTORY = 1,
  // A compass whose readings are calibrated.
  APLOMB_COMPASS_KNOWLEDGE_CALIBRATED = 2,
  // A compass whose readings lack the hard iron that the filter found in an earlier run.
  APLOMB_COMPASS_KNOWLEDGE_HARD_IRON = 3,
} AplombCompassKnowledge;

// Memory of a pipeline. Its contents are the library's own. It may be static, on the stack or in a
// larger struct, aligned as its type: to eight bytes on most targets. It may be copied within one
// run of one program. Memory that outlives a reset holds no pipeline: `aplomb_warm_start` and
// `aplomb_learned` write what a later run can use.
typedef struct AplombPipeline {
  // Contents of the library.
  uint64_t opaque[APLOMB_PIPELINE_WORDS];
} AplombPipeline;

// Calibration of one sensor and its compass, in SI units. That of the sensor is in its own axes.
// All zero is none.
typedef struct AplombCalibration {
  // Mount as in the settings; empty if the settings say it.
  char mount[8];
  // Not 0 if the gyroscope's offset and temperature are known.
  uint8_t has_gyroscope;
  // Not 0 if the offset over temperature is known.
  uint8_t has_temperature;
  // Not 0 if the accelerometer's offset and matrix are known.
  uint8_t has_accelerometer;
  // Not 0 if the level is known.
  uint8_t has_level;
  // Offset of the gyroscope, rad/s.
  float gyroscope_offset_rad_s[3];
  // Die temperature of that offset, degrees Celsius.
  float gyroscope_celsius;
  // Reference of the offset over temperature, degrees Celsius.
  float temperature_reference_celsius;
  // Offset at the reference, rad/s.
  float temperature_offset_rad_s[3];
  // Slope, rad/s per degree Celsius.
  float temperature_slope_rad_s_per_celsius[3];
  // Curvature, rad/s per square of a degree Celsius.
  float temperature_curvature_rad_s_per_celsius2[3];
  // Coldest temperature that was measured, degrees Celsius.
  float temperature_coldest_celsius;
  // Warmest temperature that was measured, degrees Celsius.
  float temperature_warmest_celsius;
  // Offset of the accelerometer, m/s²: force = matrix * (reading - offset).
  float accelerometer_offset_m_s2[3];
  // Symmetric matrix: xx, yy, zz, xy, xz, yz.
  float accelerometer_matrix[6];
  // Quaternion w, x, y, z of a small rotation from the mounted sensor to the body.
  float level[4];
  // Mount of the compass, as in the settings; empty if it is that of the sensor.
  char compass_mount[8];
  // Not 0 if the compass's matrix and hard iron are known.
  uint8_t has_compass;
  // Not 0 if the gyroscope's matrix is known.
  uint8_t has_gyroscope_matrix;
  // Zero; reserved.
  uint8_t reserved[2];
  // Matrix of the compass by rows, in body axes: field = matrix * reading - hard iron.
  float compass_matrix[9];
  // Hard iron, µT in body axes.
  float compass_hard_iron_ut[3];
  // Matrix of the gyroscope by rows, in sensor axes: rate = matrix * (reading - offset).
  // `aplomb calibrate` finds it.
  float gyroscope_matrix[9];
} AplombCalibration;

// Settings of a pipeline. Begin with `aplomb_default_settings`, and change what differs.
typedef struct AplombSettings {
  // The sensor axes along which forward and down point, such as "+x-z"; "z-up" (chip face up),
  // "z-down". A mount of the calibration comes first.
  char mount[8];
  // Full scale of the accelerometer: 2, 4, 8 or 16 g.
  uint16_t accelerometer_range_g;
  // Full scale of the gyroscope: 250, 500, 1000 or 2000 degrees per second.
  uint16_t gyroscope_range_deg_s;
  // Bandwidth of the low-pass filter: 256, 188, 98, 42, 20, 10 or 5 Hz.
  uint16_t low_pass_hz;
  // Divider of the sample rate, register SMPLRT_DIV. There are 1,000 / (divider + 1) samples a
  // second, or 8,000 / (divider + 1) if `low_pass_hz` is 256. An MPU-6500 ignores the divider at
  // 256 Hz: set 0. The divider has to match the real rate, that of samples in SI units too: 3 at
  // 256 Hz for 2,000 a second. Slower samples are pauses.
  uint8_t sample_rate_divider;
  // Answer of the sensor's register WHO_AM_I, 0x75, which is to be read: 0x68 for an MPU-6050.
  // Delay, temperature and some registers of others differ.
  uint8_t who_am_i;
  // Age of a sample's content at the sample's time, µs, 100,000 at most. Negative: that of the
  // low-pass filter.
  int32_t sensor_delay_us;
  // A value of `AplombAccelerometerKnowledge`.
  uint32_t accelerometer_knowledge;
  // A value of `AplombCompassKnowledge`, for a pipeline with a compass.
  uint32_t compass_knowledge;
  // Declination of the place, rad, east positive: the heading is then from true north.
  float declination_rad;
  // Not 0 if the caller reads the sensor's full scales back while `aplomb_awaits_scale_check`
  // returns true, and then reports `APLOMB_FLAG_SCALES_VERIFIED`.
  uint8_t verifies_scales;
  // Zero; reserved.
  uint8_t reserved[3];
  // Calibration of the sensor.
  struct AplombCalibration calibration;
} AplombSettings;

// Fourteen bytes that the sensor returned from register 0x3B on.
typedef struct AplombBurst {
  // Time of the data-ready edge, µs since start.
  uint64_t captured_at_us;
  // Bytes as the sensor sent them.
  uint8_t bytes[14];
  // Samples lost since the previous burst.
  uint8_t missed_before;
  // Zero; reserved.
  uint8_t reserved;
  // Flags that the caller reports: bus fault, sensor reset, late, polled, internal clock,
  // compass fault, scales verified.
  uint32_t board_flags;
} AplombBurst;

// Attitude at one moment, with its sigma and flags.
typedef struct AplombSnapshot {
  // Time of the sample, µs since start.
  uint64_t t_us;
  // Quaternion w, x, y, z from body (forward, right, down) to earth (north, east, down).
  float attitude[4];
  // Body rates p, q, r without bias, rad/s: those of the sample. The attitude is extrapolated to
  // `t_us`, so the rates are older by the sensor's delay.
  float body_rates_rad_s[3];
  // Right wing down positive, rad.
  float roll_rad;
  // Nose up positive, rad.
  float pitch_rad;
  // Clockwise from above positive, rad, relative to the heading at start.
  float yaw_rad;
  // Sigma of the direction of down, both axes together, rad. Infinite if unknown.
  float tilt_sigma_rad;
  // Sum of `APLOMB_FLAG_…`.
  uint32_t flags;
  // Direction of forward, clockwise from north, rad in (-pi, pi]: yaw plus offset. Zero if
  // unknown.
  float heading_rad;
  // Sigma of the heading, rad. Infinite without a compass and while the heading is unknown.
  float heading_sigma_rad;
  // Heading minus yaw, rad in (-pi, pi]. Zero if unknown.
  float yaw_offset_rad;
} AplombSnapshot;

// Sample in SI units and in the sensor's axes, as the sensor read it. The calibration and the
// mount of the settings are applied, as to a burst. For samples that are calibrated already, leave
// the calibration empty, and set `accelerometer_knowledge`. `sample_rate_divider` has to match the
// rate of the samples.
typedef struct AplombSample {
  // Time of the sample, µs since start.
  uint64_t t_us;
  // Specific force, m/s². A sensor that lies face up reads +9.81 along z.
  float specific_force_m_s2[3];
  // Angular rate, rad/s.
  float angular_rate_rad_s[3];
  // Not 0 if an axis of the accelerometer reads full scale.
  uint8_t is_force_saturated;
  // Not 0 if an axis of the gyroscope reads full scale.
  uint8_t is_rate_saturated;
  // Flags that the caller reports, as with a burst.
  uint32_t board_flags;
} AplombSample;

// Memory of a pipeline with a compass, used as `AplombPipeline` is.
typedef struct AplombCompassPipeline {
  // Contents of the library.
  uint64_t opaque[APLOMB_COMPASS_PIPELINE_WORDS];
} AplombCompassPipeline;

// Reading of a compass along its own axes. The calibration turns and corrects it.
typedef struct AplombField {
  // Magnetic field, µT. One gauss is 100 µT.
  float field_ut[3];
  // Age of the reading's motion against that of the last sample, µs:
  // `aplomb_compass_reading_age_us` returns it.
  uint32_t age_us;
} AplombField;

// Attitude and offsets of a run with a checksum, to go on from after a reset of the processor.
// Keep it in memory that a reset leaves as it is.
typedef struct AplombWarmStart {
  // Contents, to be kept as they are.
  uint8_t bytes[APLOMB_WARM_START_BYTES];
} AplombWarmStart;

// Calibration as bytes with a checksum, to keep in flash or in a file. The form is that of the
// module's flash, with slots of 256 bytes.
typedef struct AplombRecord {
  // Contents, to be kept as they are.
  uint8_t bytes[APLOMB_RECORD_BYTES];
} AplombRecord;

// Register to write to the sensor, and the wait after it.
typedef struct AplombStep {
  // Address of the register.
  uint8_t register_address;
  // Value to write.
  uint8_t value;
  // Wait before the next step, ms.
  uint16_t wait_ms;
} AplombStep;

// Neighbouring registers to read back in one transfer. The settings are intact if
// (byte & mask) == value for each byte that was read.
typedef struct AplombCheck {
  // Address of the first register.
  uint8_t register_address;
  // Number of registers, 2 to 5.
  uint8_t length;
  // Bits that count in each byte.
  uint8_t masks[APLOMB_CHECK_BYTES];
  // Values of these bits.
  uint8_t values[APLOMB_CHECK_BYTES];
} AplombCheck;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Returns the version of the library, such as "0.1.0". It differs from `APLOMB_VERSION` if the
// header is that of another library.
const char *aplomb_version(void);

// Returns what a status means and what to do, in English. Takes any number.
const char *aplomb_status_text(uint32_t status);

// Starts a pipeline with these settings, in memory with any contents. After an error the memory
// holds no pipeline.
enum AplombStatus aplomb_init(struct AplombPipeline *pipeline,
                              const struct AplombSettings *settings);

// Processes one burst. Writes the attitude at the burst's time.
enum AplombStatus aplomb_update_burst(struct AplombPipeline *pipeline,
                                      const struct AplombBurst *burst,
                                      struct AplombSnapshot *snapshot);

// Processes one sample in SI units and sensor axes, by the calibration and the mount of the
// settings. Writes the attitude at the sample's time.
enum AplombStatus aplomb_update_sample(struct AplombPipeline *pipeline,
                                       const struct AplombSample *sample,
                                       struct AplombSnapshot *snapshot);

// Writes the attitude for a time without a sample, µs since start: the last one, flagged
// `APLOMB_FLAG_STALE`, with a sigma that grows. A time before the last sample gives
// `APLOMB_STATUS_WRONG_TIME`, and no attitude.
enum AplombStatus aplomb_stale(struct AplombPipeline *pipeline,
                               uint64_t t_us,
                               struct AplombSnapshot *snapshot);

// Returns whether the rate has jumped as if the gyroscope's full scale had changed. Then read the
// settings back, and report `APLOMB_FLAG_SCALES_VERIFIED` with the next burst or sample if they
// are right. Until then no attitude is valid. False without a pipeline, or unless
// `verifies_scales` is set.
bool aplomb_awaits_scale_check(struct AplombPipeline *pipeline);

// Switches between ground and flight. Armed, the filter makes no zero-rate and no zero-velocity
// updates, so it cannot mistake a steady turn for a rest.
enum AplombStatus aplomb_set_armed(struct AplombPipeline *pipeline, bool is_armed);

// Does nothing. Its name has a number that only this header has: a program with the header of
// another library does not link. The macros `aplomb_init` and `aplomb_compass_init` call it.
void aplomb_header_b39d4de0(void);

// Starts a pipeline with a compass, in memory with any contents. Attitude, rates and tilt sigma
// are those of `AplombPipeline`, to the bit. After an error the memory holds no pipeline.
enum AplombStatus aplomb_compass_init(struct AplombCompassPipeline *pipeline,
                                      const struct AplombSettings *settings);

// Processes one burst like `aplomb_update_burst`. Writes the attitude with its heading.
enum AplombStatus aplomb_compass_update_burst(struct AplombCompassPipeline *pipeline,
                                              const struct AplombBurst *burst,
                                              struct AplombSnapshot *snapshot);

// Processes one sample like `aplomb_update_sample`. Writes the attitude with its heading.
enum AplombStatus aplomb_compass_update_sample(struct AplombCompassPipeline *pipeline,
                                               const struct AplombSample *sample,
                                               struct AplombSnapshot *snapshot);

// Takes a reading of the compass, after the update of the last sample before it. 50 to 100
// readings a second are enough. The next updates use it. A reading that no update would use gives
// `APLOMB_STATUS_WRONG_FIELD`: a field that is not finite or above 15,000 µT, or an age above a
// second.
enum AplombStatus aplomb_compass_update_field(struct AplombCompassPipeline *pipeline,
                                              const struct AplombField *field);

// Returns the age of a reading for `AplombField`, µs: how much older its motion is than that of
// the last sample, whose motion is older than its time by the sensor's delay. `measured_us` is the
// time of the middle of the measurement, on the clock of the samples: its low 32 bits. Zero for a
// later motion, and without a pipeline.
uint32_t aplomb_compass_reading_age_us(struct AplombCompassPipeline *pipeline,
                                       uint32_t measured_us);

// Writes the attitude for a time without a sample, as `aplomb_stale` does. The heading is the last
// one, without `APLOMB_FLAG_HEADING_VALID`.
enum AplombStatus aplomb_compass_stale(struct AplombCompassPipeline *pipeline,
                                       uint64_t t_us,
                                       struct AplombSnapshot *snapshot);

// Returns whether the full scales have to be read back, as `aplomb_awaits_scale_check` does.
bool aplomb_compass_awaits_scale_check(struct AplombCompassPipeline *pipeline);

// Switches between ground and flight like `aplomb_set_armed`.
enum AplombStatus aplomb_compass_set_armed(struct AplombCompassPipeline *pipeline,
                                           bool is_armed);

// Writes the calibration in use, with the offsets that this run has found, for the settings of the
// next run or for `aplomb_encode_record`. Offsets that are not certain stay as they are: the
// gyroscope's is certain at rest, and the accelerometer's after motion. The compass's is left out:
// `aplomb_compass_learned` writes it.
enum AplombStatus aplomb_learned(struct AplombPipeline *pipeline,
                                 struct AplombCalibration *calibration);

// Writes the calibration like `aplomb_learned`, and the compass's with the hard iron that this run
// has found, once it is certain.
enum AplombStatus aplomb_compass_learned(struct AplombCompassPipeline *pipeline,
                                         struct AplombCalibration *calibration);

// Writes the state at this time, µs since start, not before the last sample. Only the latest
// state is of use after a reset, so write it often, such as ten times a second. Write two in
// turn: a reset may cut one. Gives `APLOMB_STATUS_NO_STATE` before a rest has measured the
// gyroscope's offset.
enum AplombStatus aplomb_warm_start(struct AplombPipeline *pipeline,
                                    uint64_t t_us,
                                    struct AplombWarmStart *start);

// Goes on from the state of an earlier run with the same settings. Call it after `aplomb_init` and
// before the first sample, which comes after `t_us`, the present time. `age_us` is the longest
// time since the state was written: sigma grows with it. Without a whole state it gives
// `APLOMB_STATUS_NO_RECORD`, and the pipeline starts as without one. Do not call it after a
// power-up.
enum AplombStatus aplomb_resume(struct AplombPipeline *pipeline,
                                const struct AplombWarmStart *start,
                                uint64_t t_us,
                                uint32_t age_us);

// Writes the state like `aplomb_warm_start`. It has no heading.
enum AplombStatus aplomb_compass_warm_start(struct AplombCompassPipeline *pipeline,
                                            uint64_t t_us,
                                            struct AplombWarmStart *start);

// Goes on from the state of an earlier run like `aplomb_resume`. The heading starts anew.
enum AplombStatus aplomb_compass_resume(struct AplombCompassPipeline *pipeline,
                                        const struct AplombWarmStart *start,
                                        uint64_t t_us,
                                        uint32_t age_us);

// Writes a calibration as a record, that of the compass included.
enum AplombStatus aplomb_encode_record(const struct AplombCalibration *calibration,
                                       struct AplombRecord *record);

// Reads the calibration of a record.
enum AplombStatus aplomb_decode_record(const struct AplombRecord *record,
                                       struct AplombCalibration *calibration);

// Writes the step of this index, from 0, of the sensor's configuration. Write its value to the
// sensor, wait, and go on with the next. After the last one returns `APLOMB_STATUS_NO_MORE_STEPS`.
enum AplombStatus aplomb_configuration_step(const struct AplombSettings *settings,
                                            uint32_t index,
                                            struct AplombStep *step);

// Writes a step like `aplomb_configuration_step`, for a sensor that has reset itself or has lost a
// setting. All steps take 30 ms, because none resets the sensor. Check the settings after them.
enum AplombStatus aplomb_reconfiguration_step(const struct AplombSettings *settings,
                                              uint32_t index,
                                              struct AplombStep *step);

// Writes the check of this index, from 0, of the sensor's settings: together they cover each
// setting that `aplomb_configuration_step` writes. After the last one returns
// `APLOMB_STATUS_NO_MORE_STEPS`.
enum AplombStatus aplomb_settings_check(const struct AplombSettings *settings,
                                        uint32_t index,
                                        struct AplombCheck *check);

// Returns the settings of an MPU-6050 at 1,000 samples a second, chip face up, X forward.
struct AplombSettings aplomb_default_settings(void);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

/* Each program refers to the number of its header: see aplomb_header_b39d4de0. */
#define aplomb_init(pipeline, settings) \
    (aplomb_header_b39d4de0(), aplomb_init(pipeline, settings))
#define aplomb_compass_init(pipeline, settings) \
    (aplomb_header_b39d4de0(), aplomb_compass_init(pipeline, settings))

#endif  /* APLOMB_H */
