/* Checks each function at its boundary: null pointers, wrong settings, wild values, records. */
#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "aplomb.h"

static AplombPipeline pipeline;
static AplombCompassPipeline with_compass;
static uint32_t state = 1;

static uint32_t chance(void)
{
    state = state * 1664525u + 1013904223u;
    return state >> 8;
}

static void fill(void *memory, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        ((unsigned char *)memory)[i] = (unsigned char)chance();
    }
}

static void settings_are_checked(void)
{
    AplombSettings settings = aplomb_default_settings();
    AplombSettings wrong = settings;
    assert(aplomb_init(NULL, &settings) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_init(&pipeline, NULL) == APLOMB_STATUS_NULL_POINTER);
    memcpy(wrong.mount, "+x+x\0\0\0", 8);
    assert(aplomb_init(&pipeline, &wrong) == APLOMB_STATUS_WRONG_MOUNT);
    fill(wrong.mount, 8);
    assert(aplomb_init(&pipeline, &wrong) == APLOMB_STATUS_WRONG_MOUNT);
    wrong = settings;
    wrong.accelerometer_range_g = 3;
    assert(aplomb_init(&pipeline, &wrong) == APLOMB_STATUS_WRONG_RANGE);
    wrong = settings;
    wrong.low_pass_hz = 100;
    assert(aplomb_init(&pipeline, &wrong) == APLOMB_STATUS_WRONG_LOW_PASS);
    wrong = settings;
    wrong.who_am_i = 0;
    assert(aplomb_init(&pipeline, &wrong) == APLOMB_STATUS_UNKNOWN_PART);
    wrong = settings;
    wrong.sensor_delay_us = 100001;
    assert(aplomb_init(&pipeline, &wrong) == APLOMB_STATUS_WRONG_DELAY);
    wrong.sensor_delay_us = 100000;
    assert(aplomb_init(&pipeline, &wrong) == APLOMB_STATUS_OK);
    wrong.accelerometer_knowledge = 4;
    assert(aplomb_init(&pipeline, &wrong) == APLOMB_STATUS_WRONG_KNOWLEDGE);
    for (uint32_t status = 0; status < 23; status++) {
        assert(strlen(aplomb_status_text(status)) > 3);
    }
    assert(aplomb_status_text(0xFFFFFFFFu) != NULL);
    memset(&wrong, 0, sizeof wrong);
    AplombStatus status = aplomb_init(&pipeline, &wrong);
    assert(status != APLOMB_STATUS_OK);
    assert(strstr(aplomb_status_text(status), "begin with aplomb_default_settings") != NULL);
    assert(strcmp(aplomb_version(), APLOMB_VERSION) == 0);
    assert(APLOMB_VERSION_MAJOR + APLOMB_VERSION_MINOR + APLOMB_VERSION_PATCH > 0);
}

/* A pipeline with the settings from before would go on unnoticed. */
static void a_failed_start_leaves_no_pipeline(void)
{
    AplombSettings settings = aplomb_default_settings();
    AplombSettings wrong = settings;
    AplombSnapshot snapshot;
    wrong.low_pass_hz = 100;
    assert(aplomb_init(&pipeline, &settings) == APLOMB_STATUS_OK);
    assert(aplomb_stale(&pipeline, 0, &snapshot) == APLOMB_STATUS_OK);
    snapshot.flags &= ~APLOMB_FLAG_STALE; /* no warning about signs */
    assert(aplomb_init(&pipeline, &wrong) == APLOMB_STATUS_WRONG_LOW_PASS);
    assert(aplomb_stale(&pipeline, 0, &snapshot) == APLOMB_STATUS_NOT_INITIALISED);
    assert(aplomb_compass_init(&with_compass, &settings) == APLOMB_STATUS_OK);
    assert(aplomb_compass_init(&with_compass, NULL) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_compass_stale(&with_compass, 0, &snapshot) == APLOMB_STATUS_NOT_INITIALISED);
}

static void settings_of_a_compass_are_checked(void)
{
    AplombSettings settings = aplomb_default_settings();
    AplombSettings wrong = settings;
    assert(aplomb_compass_init(NULL, &settings) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_compass_init(&with_compass, NULL) == APLOMB_STATUS_NULL_POINTER);
    wrong.low_pass_hz = 100;
    assert(aplomb_compass_init(&with_compass, &wrong) == APLOMB_STATUS_WRONG_LOW_PASS);
    wrong = settings;
    wrong.compass_knowledge = APLOMB_COMPASS_KNOWLEDGE_HARD_IRON;
    assert(aplomb_compass_init(&with_compass, &wrong) == APLOMB_STATUS_OK);
    wrong.compass_knowledge = APLOMB_COMPASS_KNOWLEDGE_HARD_IRON + 1;
    assert(aplomb_compass_init(&with_compass, &wrong) == APLOMB_STATUS_WRONG_KNOWLEDGE);
    wrong = settings;
    memcpy(wrong.calibration.compass_mount, "+x+x\0\0\0", 8);
    assert(aplomb_compass_init(&with_compass, &wrong) == APLOMB_STATUS_WRONG_MOUNT);
    wrong = settings;
    wrong.declination_rad = 3.2f;
    assert(aplomb_compass_init(&with_compass, &wrong) == APLOMB_STATUS_WRONG_DECLINATION);
    wrong.declination_rad = NAN;
    assert(aplomb_compass_init(&with_compass, &wrong) == APLOMB_STATUS_WRONG_DECLINATION);
    assert(aplomb_init(&pipeline, &wrong) == APLOMB_STATUS_OK); /* it has no compass */
}

static void steps_are_those_of_the_datasheet(void)
{
    AplombSettings settings = aplomb_default_settings();
    AplombStep step;
    uint32_t index = 0;
    assert(aplomb_configuration_step(&settings, 0, &step) == APLOMB_STATUS_OK);
    assert(step.register_address == 0x6B && step.value == 0x80 && step.wait_ms == 100);
    while (aplomb_configuration_step(&settings, index, &step) == APLOMB_STATUS_OK) {
        index++;
    }
    assert(index == 10);
    assert(aplomb_configuration_step(&settings, 0xFFFFFFFFu, &step) ==
           APLOMB_STATUS_NO_MORE_STEPS);
    assert(aplomb_configuration_step(NULL, 0, &step) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_configuration_step(&settings, 0, NULL) == APLOMB_STATUS_NULL_POINTER);
}

/* A restoration has the same values, without the device reset. */
static void a_restoration_and_the_checks_are_those_of_the_datasheet(void)
{
    AplombSettings settings = aplomb_default_settings(), wrong = settings;
    AplombStep step;
    AplombCheck check;
    uint32_t wait_ms = 0, index = 0;
    for (; aplomb_reconfiguration_step(&settings, index, &step) == APLOMB_STATUS_OK; index++) {
        assert(step.value != 0x80);
        wait_ms += step.wait_ms;
    }
    assert(wait_ms == 30 && index == 8);
    assert(aplomb_settings_check(&settings, 0, &check) == APLOMB_STATUS_OK);
    assert(check.register_address == 0x19 && check.length == 5);
    assert(check.masks[2] == 0xF8 && check.values[2] == 0x18 && check.masks[4] == 0);
    assert(aplomb_settings_check(&settings, 1, &check) == APLOMB_STATUS_OK);
    assert(check.register_address == 0x37 && check.length == 2 && check.values[1] == 1);
    assert(aplomb_settings_check(&settings, 2, &check) == APLOMB_STATUS_OK);
    assert(check.register_address == 0x6B && check.length == 2 && check.masks[1] == 0xFF);
    assert(aplomb_settings_check(&settings, 3, &check) == APLOMB_STATUS_NO_MORE_STEPS);
    settings.who_am_i = 0x70; /* an MPU-6500 has a second low-pass filter */
    assert(aplomb_settings_check(&settings, 0, &check) == APLOMB_STATUS_OK);
    assert(check.masks[4] == 0x0F && check.values[4] == 1);
    assert(aplomb_settings_check(NULL, 0, &check) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_settings_check(&settings, 0, NULL) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_reconfiguration_step(NULL, 0, &step) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_reconfiguration_step(&settings, 0, NULL) == APLOMB_STATUS_NULL_POINTER);
    wrong.who_am_i = 0;
    assert(aplomb_settings_check(&wrong, 0, &check) == APLOMB_STATUS_UNKNOWN_PART);
}

static void records_read_back(void)
{
    AplombCalibration calibration, found;
    AplombRecord record;
    memset(&calibration, 0, sizeof calibration);
    calibration.has_accelerometer = 1;
    calibration.has_compass = 1;
    memcpy(calibration.compass_mount, "+y-z", 4);
    for (int i = 0; i < 9; i++) {
        calibration.compass_matrix[i] = (i % 4 == 0 ? 1.0f : 0.0f) + 0.03125f * (float)i;
    }
    calibration.compass_hard_iron_ut[2] = -30.5f;
    calibration.has_gyroscope_matrix = 1;
    for (int i = 0; i < 9; i += 4) {
        calibration.gyroscope_matrix[i] = 1.0f;
    }
    calibration.gyroscope_matrix[5] = -0.0625f;
    calibration.accelerometer_offset_m_s2[1] = 0.25f;
    for (int i = 0; i < 3; i++) {
        calibration.accelerometer_matrix[i] = 1.0f;
    }
    assert(aplomb_encode_record(&calibration, &record) == APLOMB_STATUS_OK);
    assert(aplomb_decode_record(&record, &found) == APLOMB_STATUS_OK);
    assert(found.has_accelerometer && !found.has_level && !found.has_gyroscope);
    assert(found.accelerometer_offset_m_s2[1] == 0.25f && found.accelerometer_matrix[2] == 1.0f);
    assert(found.has_compass == 1 && strcmp(found.compass_mount, "+y-z") == 0);
    assert(memcmp(found.compass_matrix, calibration.compass_matrix,
                  sizeof found.compass_matrix) == 0);
    assert(found.compass_hard_iron_ut[2] == -30.5f);
    assert(found.has_gyroscope_matrix == 1 && found.gyroscope_matrix[5] == -0.0625f);
    record.bytes[40] ^= 1;
    assert(aplomb_decode_record(&record, &found) == APLOMB_STATUS_NO_RECORD);
    for (int i = 0; i < 2000; i++) {
        fill(&record, sizeof record);
        assert(aplomb_decode_record(&record, &found) == APLOMB_STATUS_NO_RECORD);
    }
    calibration.accelerometer_offset_m_s2[0] = NAN;
    assert(aplomb_encode_record(&calibration, &record) == APLOMB_STATUS_NOT_STORABLE);
    calibration.accelerometer_offset_m_s2[0] = 0.0f;
    calibration.accelerometer_matrix[0] = 0.0f;
    assert(aplomb_encode_record(&calibration, &record) == APLOMB_STATUS_WRONG_ACCELEROMETER);
    calibration.accelerometer_matrix[0] = 1.0f;
    calibration.compass_hard_iron_ut[0] = INFINITY;
    assert(aplomb_encode_record(&calibration, &record) == APLOMB_STATUS_NOT_STORABLE);
    calibration.compass_hard_iron_ut[0] = 0.0f;
    memset(calibration.compass_matrix, 0, sizeof calibration.compass_matrix);
    assert(aplomb_encode_record(&calibration, &record) == APLOMB_STATUS_WRONG_COMPASS);
    calibration.compass_mount[0] = 'x';
    assert(aplomb_encode_record(&calibration, &record) == APLOMB_STATUS_WRONG_MOUNT);
    assert(aplomb_encode_record(NULL, &record) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_decode_record(NULL, &found) == APLOMB_STATUS_NULL_POINTER);
}

/* Both kinds of pipeline refuse this calibration. */
static void is_refused(const AplombSettings *settings, AplombStatus status)
{
    assert(aplomb_init(&pipeline, settings) == status);
    assert(aplomb_compass_init(&with_compass, settings) == status);
}

static void calibrations_that_no_sensor_has_are_refused(void)
{
    AplombSettings usual = aplomb_default_settings(), wrong;
    wrong = usual;
    wrong.calibration.has_gyroscope_matrix = 1; /* the matrix is forgotten */
    is_refused(&wrong, APLOMB_STATUS_WRONG_GYROSCOPE_MATRIX);
    wrong.calibration.gyroscope_matrix[3] = NAN;
    is_refused(&wrong, APLOMB_STATUS_NOT_STORABLE);
    wrong = usual;
    wrong.calibration.has_accelerometer = 1;
    is_refused(&wrong, APLOMB_STATUS_WRONG_ACCELEROMETER);
    wrong.calibration.accelerometer_offset_m_s2[1] = INFINITY;
    is_refused(&wrong, APLOMB_STATUS_NOT_STORABLE);
    wrong = usual;
    wrong.calibration.has_gyroscope = 1;
    wrong.calibration.gyroscope_offset_rad_s[2] = 2.5f; /* in degrees per second */
    is_refused(&wrong, APLOMB_STATUS_WRONG_GYROSCOPE_OFFSET);
    wrong.calibration.gyroscope_offset_rad_s[2] = NAN;
    is_refused(&wrong, APLOMB_STATUS_NOT_STORABLE);
    wrong = usual;
    wrong.calibration.has_temperature = 1;
    wrong.calibration.temperature_warmest_celsius = 40.0f;
    wrong.calibration.temperature_offset_rad_s[0] = 1.5f; /* in degrees per second */
    is_refused(&wrong, APLOMB_STATUS_WRONG_TEMPERATURE_OFFSET);
    wrong.calibration.temperature_coldest_celsius = 50.0f; /* exchanged */
    is_refused(&wrong, APLOMB_STATUS_WRONG_TEMPERATURE_RANGE);
    wrong.calibration.temperature_slope_rad_s_per_celsius[0] = NAN;
    is_refused(&wrong, APLOMB_STATUS_NOT_STORABLE);
    wrong = usual;
    wrong.calibration.has_level = 1;
    is_refused(&wrong, APLOMB_STATUS_WRONG_LEVEL);
    wrong.calibration.level[1] = 1.0f; /* upside down */
    is_refused(&wrong, APLOMB_STATUS_WRONG_LEVEL);
    wrong = usual;
    wrong.calibration.has_compass = 1;
    wrong.calibration.compass_matrix[0] = NAN;
    assert(aplomb_compass_init(&with_compass, &wrong) == APLOMB_STATUS_NOT_STORABLE);
    wrong.calibration.compass_matrix[0] = 0.0f;
    wrong.calibration.compass_hard_iron_ut[0] = 20.0f; /* alone: the matrix is forgotten */
    assert(aplomb_compass_init(&with_compass, &wrong) == APLOMB_STATUS_WRONG_COMPASS);
    assert(aplomb_init(&pipeline, &wrong) == APLOMB_STATUS_OK); /* it has no compass */
    for (int i = 0; i < 9; i += 4) {
        wrong.calibration.compass_matrix[i] = 1.0f;
    }
    assert(aplomb_compass_init(&with_compass, &wrong) == APLOMB_STATUS_OK);
}

/* A sensor with an offset, a matrix and a mount, in motion from its first sample on. */
static AplombSettings settings_of_a_calibrated_sensor(void)
{
    static const float scale[9] = {1.02f, 0.01f, 0, 0, 0.98f, 0, 0, 0.02f, 1.01f};
    AplombSettings settings = aplomb_default_settings();
    AplombCalibration *calibration = &settings.calibration;
    memcpy(calibration->mount, "+y-z\0\0\0", 8);
    calibration->has_gyroscope = calibration->has_gyroscope_matrix = 1;
    calibration->gyroscope_offset_rad_s[0] = 0.35f;
    calibration->gyroscope_celsius = 25.0f;
    memcpy(calibration->gyroscope_matrix, scale, sizeof scale);
    calibration->has_accelerometer = 1;
    calibration->accelerometer_offset_m_s2[0] = 0.6f;
    calibration->accelerometer_offset_m_s2[1] = 1.2f;
    for (int i = 0; i < 3; i++) {
        calibration->accelerometer_matrix[i] = 0.97f + 0.02f * (float)i;
    }
    return settings;
}

static void samples_give_the_attitudes_of_their_bursts(void)
{
    AplombSettings settings = settings_of_a_calibrated_sensor();
    AplombSnapshot of_burst, of_sample, of_compass;
    AplombPipeline of_bursts;
    assert(aplomb_init(&of_bursts, &settings) == APLOMB_STATUS_OK);
    assert(aplomb_init(&pipeline, &settings) == APLOMB_STATUS_OK);
    assert(aplomb_compass_init(&with_compass, &settings) == APLOMB_STATUS_OK);
    for (int i = 1; i < 4000; i++) {
        double turn = 0.6 * sin(2e-3 * i), rate = 1.2 * cos(2e-3 * i);
        double force[3] = {-9.8 * sin(turn) + 0.6, 1.2, 9.8 * cos(turn)};
        double rates[3] = {0.35, rate, 0.0};
        AplombBurst burst = {0};
        AplombSample sample = {0};
        burst.captured_at_us = sample.t_us = 1000u * (unsigned)i;
        burst.bytes[6] = 0xF0; /* 25 degrees Celsius */
        burst.bytes[7] = 0xB0;
        for (int axis = 0; axis < 3; axis++) {
            long counts[2];
            counts[0] = lround(force[axis] / 9.80665 * 2048.0) + (long)(chance() % 4);
            counts[1] = lround(rates[axis] * 57.29578 * 16.4) + (long)(chance() % 4);
            sample.specific_force_m_s2[axis] = (float)counts[0] / 2048.0f * 9.80665f;
            sample.angular_rate_rad_s[axis] = (float)counts[1] / 16.4f / 57.29578f;
            for (int sensor = 0; sensor < 2; sensor++) {
                burst.bytes[8 * sensor + 2 * axis] = (uint8_t)(counts[sensor] >> 8);
                burst.bytes[8 * sensor + 2 * axis + 1] = (uint8_t)counts[sensor];
            }
        }
        aplomb_update_burst(&of_bursts, &burst, &of_burst);
        aplomb_update_sample(&pipeline, &sample, &of_sample);
        aplomb_compass_update_sample(&with_compass, &sample, &of_compass);
        assert(of_sample.flags == of_burst.flags);
        for (int part = 0; part < 4; part++) {
            assert(fabsf(of_sample.attitude[part] - of_burst.attitude[part]) < 1e-4f);
            assert(of_compass.attitude[part] == of_sample.attitude[part]);
        }
    }
    assert(of_sample.flags & APLOMB_FLAG_VALID);
}

/* A jump of the rate waits for the caller only if the caller has promised to look. */
static void a_rate_jump_waits_for_the_full_scales(void)
{
    AplombSettings settings = aplomb_default_settings();
    for (uint8_t verifies = 0; verifies < 2; verifies++) {
        AplombSnapshot snapshot, of_compass;
        AplombBurst burst = {0};
        settings.verifies_scales = verifies;
        assert(aplomb_init(&pipeline, &settings) == APLOMB_STATUS_OK);
        assert(aplomb_compass_init(&with_compass, &settings) == APLOMB_STATUS_OK);
        burst.bytes[4] = 8;    /* level */
        burst.bytes[6] = 0xF0; /* 25 degrees Celsius */
        for (unsigned i = 1; i < 3003; i++) {
            burst.captured_at_us = 1000u * i;
            burst.bytes[1] = (uint8_t)(chance() % 4);
            burst.bytes[13] = (uint8_t)(chance() % 4);
            if (i == 3000) {
                assert(snapshot.flags & APLOMB_FLAG_VALID);
                assert(!aplomb_awaits_scale_check(&pipeline));
            }
            if (i >= 3000) {
                burst.bytes[12] = 5; /* 78 degrees per second */
            }
            burst.board_flags = i == 3002 ? APLOMB_FLAG_SCALES_VERIFIED : 0;
            aplomb_update_burst(&pipeline, &burst, &snapshot);
            aplomb_compass_update_burst(&with_compass, &burst, &of_compass);
            bool waits = verifies && (i == 3000 || i == 3001);
            assert(aplomb_awaits_scale_check(&pipeline) == waits);
            assert(aplomb_compass_awaits_scale_check(&with_compass) == waits);
            assert(!waits || !((snapshot.flags | of_compass.flags) & APLOMB_FLAG_VALID));
        }
        assert(snapshot.flags & of_compass.flags & APLOMB_FLAG_VALID);
        assert(!(snapshot.flags & APLOMB_FLAG_SCALES_VERIFIED));
    }
}

/* Samples in SI units wait as bursts do, and report as they do. */
static void samples_wait_for_the_full_scales_too(void)
{
    AplombSettings settings = aplomb_default_settings();
    AplombSnapshot snapshot, of_compass;
    settings.verifies_scales = 1;
    assert(aplomb_init(&pipeline, &settings) == APLOMB_STATUS_OK);
    assert(aplomb_compass_init(&with_compass, &settings) == APLOMB_STATUS_OK);
    for (unsigned i = 1; i < 3005; i++) {
        AplombSample sample = {0, {0.0f, 0.0f, 9.81f}, {0.0f, 0.0f, 0.0f}, 0, 0, 0};
        sample.t_us = 1000u * i;
        sample.angular_rate_rad_s[0] = 1e-3f * (float)(chance() % 4);
        sample.angular_rate_rad_s[2] = i < 3000 ? 0.0f : 1.4f;
        sample.board_flags = i == 3002   ? APLOMB_FLAG_BUS_FAULT
                             : i == 3003 ? APLOMB_FLAG_SCALES_VERIFIED
                                         : 0;
        assert(aplomb_update_sample(&pipeline, &sample, &snapshot) == APLOMB_STATUS_OK);
        assert(aplomb_compass_update_sample(&with_compass, &sample, &of_compass) ==
               APLOMB_STATUS_OK);
        bool waits = i >= 3000 && i <= 3002;
        assert(aplomb_awaits_scale_check(&pipeline) == waits);
        assert(aplomb_compass_awaits_scale_check(&with_compass) == waits);
        assert(snapshot.flags == of_compass.flags);
        assert(i < 2990 || ((snapshot.flags & APLOMB_FLAG_VALID) != 0) == !waits);
        assert(((snapshot.flags & APLOMB_FLAG_BUS_FAULT) != 0) == (i == 3002));
    }
}

/* A clock of 32 bits that wraps gives no stale attitude whose sigma does not grow. */
static void a_stale_time_before_the_last_sample_is_refused(void)
{
    AplombSettings settings = aplomb_default_settings();
    AplombSample sample = {5000000000u, {0.0f, 0.0f, 9.81f}, {0.0f, 0.0f, 0.0f}, 0, 0, 0};
    AplombSnapshot snapshot;
    assert(aplomb_init(&pipeline, &settings) == APLOMB_STATUS_OK);
    assert(aplomb_compass_init(&with_compass, &settings) == APLOMB_STATUS_OK);
    assert(aplomb_update_sample(&pipeline, &sample, &snapshot) == APLOMB_STATUS_OK);
    assert(aplomb_compass_update_sample(&with_compass, &sample, &snapshot) == APLOMB_STATUS_OK);
    assert(aplomb_stale(&pipeline, sample.t_us, &snapshot) == APLOMB_STATUS_OK);
    assert(aplomb_compass_stale(&with_compass, sample.t_us, &snapshot) == APLOMB_STATUS_OK);
    snapshot.t_us = 7;
    sample.t_us = (uint32_t)sample.t_us;
    assert(aplomb_stale(&pipeline, sample.t_us, &snapshot) == APLOMB_STATUS_WRONG_TIME);
    assert(aplomb_compass_stale(&with_compass, sample.t_us, &snapshot) ==
           APLOMB_STATUS_WRONG_TIME);
    assert(snapshot.t_us == 7);
}

/* A reading that the filter would not use is refused. The age is that of the motion. */
static void fields_that_no_compass_gives_are_refused(void)
{
    AplombSettings settings = aplomb_default_settings();
    AplombSample sample = {5000000, {0.0f, 0.0f, 9.81f}, {0.0f, 0.0f, 0.0f}, 0, 0, 0};
    AplombSnapshot snapshot;
    AplombField field = {{20.0f, 0.0f, -44.0f}, 1000000};
    assert(aplomb_compass_init(&with_compass, &settings) == APLOMB_STATUS_OK);
    assert(aplomb_compass_update_sample(&with_compass, &sample, &snapshot) == APLOMB_STATUS_OK);
    assert(aplomb_compass_update_field(&with_compass, &field) == APLOMB_STATUS_OK);
    field.age_us = 0u - 1500u; /* a later motion: the age underflows */
    assert(aplomb_compass_update_field(&with_compass, &field) == APLOMB_STATUS_WRONG_FIELD);
    /* The low-pass filter delays the sample's motion by 1.9 ms. */
    assert(aplomb_compass_reading_age_us(&with_compass, 4990000) == 8100);
    field.age_us = aplomb_compass_reading_age_us(&with_compass, 4999600);
    assert(field.age_us == 0);
    assert(aplomb_compass_update_field(&with_compass, &field) == APLOMB_STATUS_OK);
    field.field_ut[1] = NAN;
    assert(aplomb_compass_update_field(&with_compass, &field) == APLOMB_STATUS_WRONG_FIELD);
    field.field_ut[1] = 20000.0f; /* in nT */
    assert(aplomb_compass_update_field(&with_compass, &field) == APLOMB_STATUS_WRONG_FIELD);
    assert(aplomb_compass_reading_age_us(NULL, 0) == 0);
}

/* A body that rests, and turns to and fro about all axes. Writes its quaternion, body (forward,
 * left, up) to earth, and its rates. */
static void move(double t_s, double q[4], double rates[3])
{
    double step = t_s < 3.0 ? 0.0 : 1e-3, norm = 0.0, a[4];
    for (int axis = 0; axis < 3; axis++) {
        rates[axis] = t_s < 3.0 ? 0.0 : 1.5 * sin((0.7 + 0.4 * axis) * (t_s - 3.0) + axis);
    }
    memcpy(a, q, sizeof a);
    q[0] -= 0.5 * step * (a[1] * rates[0] + a[2] * rates[1] + a[3] * rates[2]);
    q[1] += 0.5 * step * (a[0] * rates[0] + a[2] * rates[2] - a[3] * rates[1]);
    q[2] += 0.5 * step * (a[0] * rates[1] - a[1] * rates[2] + a[3] * rates[0]);
    q[3] += 0.5 * step * (a[0] * rates[2] + a[1] * rates[1] - a[2] * rates[0]);
    for (int i = 0; i < 4; i++) {
        norm += q[i] * q[i];
    }
    for (int i = 0; i < 4; i++) {
        q[i] /= sqrt(norm);
    }
}

/* Returns the component of a vector in earth's axes (x, z) along this axis of the body. */
static float along(const double q[4], int axis, double x, double z)
{
    const double rows[3][2] = {
        {1 - 2 * (q[2] * q[2] + q[3] * q[3]), 2 * (q[1] * q[3] - q[0] * q[2])},
        {2 * (q[1] * q[2] - q[0] * q[3]), 2 * (q[2] * q[3] + q[0] * q[1])},
        {2 * (q[1] * q[3] + q[0] * q[2]), 1 - 2 * (q[1] * q[1] + q[2] * q[2])},
    };
    return (float)(rows[axis][0] * x + rows[axis][1] * z);
}

/* The next run starts with the offsets that this one has found, also by way of a record. */
static void a_run_keeps_what_it_has_learned(void)
{
    static const float offset[3] = {0.02f, -0.03f, 0.01f}, iron_ut[3] = {12.0f, -20.0f, 8.0f};
    static const float force_offset[3] = {0.4f, -0.3f, 0.0f};
    AplombSettings settings = aplomb_default_settings();
    AplombCalibration learned;
    AplombRecord record;
    AplombSnapshot snapshot;
    double q[4] = {1, 0, 0, 0}, rates[3];
    settings.sensor_delay_us = 0;
    assert(aplomb_init(&pipeline, &settings) == APLOMB_STATUS_OK);
    assert(aplomb_compass_init(&with_compass, &settings) == APLOMB_STATUS_OK);
    assert(aplomb_compass_learned(&with_compass, &learned) == APLOMB_STATUS_OK);
    assert(!learned.has_gyroscope && !learned.has_accelerometer && !learned.has_compass);
    for (unsigned i = 1; i < 60000; i++) {
        AplombSample sample = {0, {0, 0, 0}, {0, 0, 0}, 0, 0, 0};
        AplombField field = {{0, 0, 0}, 0};
        move(1e-3 * i, q, rates);
        sample.t_us = 1000u * i;
        for (int axis = 0; axis < 3; axis++) {
            float noise = 1e-3f * (float)(chance() % 5);
            sample.specific_force_m_s2[axis] = along(q, axis, 0.0, 9.81) + force_offset[axis];
            sample.specific_force_m_s2[axis] += 10.0f * noise;
            sample.angular_rate_rad_s[axis] = (float)rates[axis] + offset[axis] + noise;
            field.field_ut[axis] = along(q, axis, 20.0, -44.0) + iron_ut[axis];
        }
        aplomb_update_sample(&pipeline, &sample, &snapshot);
        aplomb_compass_update_sample(&with_compass, &sample, &snapshot);
        if (i % 10 == 0) {
            aplomb_compass_update_field(&with_compass, &field);
        }
        if (i == 2900) { /* at rest */
            assert(aplomb_learned(&pipeline, &learned) == APLOMB_STATUS_OK);
            assert(learned.has_gyroscope && !learned.has_compass);
            for (int axis = 0; axis < 3; axis++) {
                float found = learned.gyroscope_offset_rad_s[axis];
                assert(fabsf(found - offset[axis] - 0.002f) < 1e-3f);
            }
        }
    }
    assert(snapshot.flags & APLOMB_FLAG_HEADING_VALID);
    assert(aplomb_compass_learned(&with_compass, &learned) == APLOMB_STATUS_OK);
    assert(learned.has_compass && learned.compass_matrix[4] == 1.0f);
    assert(learned.has_accelerometer && learned.accelerometer_matrix[0] == 1.0f);
    for (int axis = 0; axis < 2; axis++) {
        float found = learned.accelerometer_offset_m_s2[axis];
        assert(fabsf(found - force_offset[axis] - 0.02f) < 0.1f);
    }
    for (int axis = 0; axis < 3; axis++) {
        /* In body axes: forward, right, down. */
        float found = learned.compass_hard_iron_ut[axis] * (axis == 0 ? 1.0f : -1.0f);
        assert(fabsf(found - iron_ut[axis]) < 3.0f);
    }
    assert(aplomb_encode_record(&learned, &record) == APLOMB_STATUS_OK);
    assert(aplomb_decode_record(&record, &settings.calibration) == APLOMB_STATUS_OK);
    assert(settings.calibration.compass_hard_iron_ut[0] == learned.compass_hard_iron_ut[0]);
    assert(aplomb_compass_init(&with_compass, &settings) == APLOMB_STATUS_OK);
    assert(aplomb_learned(NULL, &learned) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_learned(&pipeline, NULL) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_compass_learned(NULL, &learned) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_compass_learned(&with_compass, NULL) == APLOMB_STATUS_NULL_POINTER);
}

/* After a reset the attitude goes on at once, with the sigma of its age, and without a rest. */
static void a_run_goes_on_after_a_reset(void)
{
    AplombSettings settings = aplomb_default_settings();
    AplombSample sample = {0, {0.0f, 4.903f, 8.493f}, {0.0f, 0.0f, 0.0f}, 0, 0, 0};
    AplombSnapshot before, after, of_compass;
    AplombWarmStart start, of_pipeline, damaged;
    assert(aplomb_init(&pipeline, &settings) == APLOMB_STATUS_OK);
    assert(aplomb_compass_init(&with_compass, &settings) == APLOMB_STATUS_OK);
    assert(aplomb_warm_start(&pipeline, 0, &start) == APLOMB_STATUS_NO_STATE);
    assert(aplomb_compass_warm_start(&with_compass, 0, &start) == APLOMB_STATUS_NO_STATE);
    for (unsigned i = 1; i < 3000; i++) {
        sample.t_us = 1000u * i;
        sample.angular_rate_rad_s[1] = 0.02f + 1e-3f * (float)(chance() % 4);
        aplomb_update_sample(&pipeline, &sample, &before);
        aplomb_compass_update_sample(&with_compass, &sample, &before);
    }
    assert(aplomb_warm_start(&pipeline, 2998999, &start) == APLOMB_STATUS_WRONG_TIME);
    assert(aplomb_warm_start(&pipeline, 2999000, &of_pipeline) == APLOMB_STATUS_OK);
    assert(aplomb_compass_warm_start(&with_compass, 2999000, &start) == APLOMB_STATUS_OK);
    assert(memcmp(&start, &of_pipeline, sizeof start) == 0);
    for (uint32_t age_us = 0; age_us <= 300000; age_us += 300000) {
        assert(aplomb_init(&pipeline, &settings) == APLOMB_STATUS_OK);
        assert(aplomb_compass_init(&with_compass, &settings) == APLOMB_STATUS_OK);
        assert(aplomb_resume(&pipeline, &start, 5000, age_us) == APLOMB_STATUS_OK);
        assert(aplomb_compass_resume(&with_compass, &start, 5000, age_us) == APLOMB_STATUS_OK);
        sample.t_us = 6000;
        sample.specific_force_m_s2[1] = 0.0f; /* in motion: it does not show the tilt */
        aplomb_update_sample(&pipeline, &sample, &after);
        aplomb_compass_update_sample(&with_compass, &sample, &of_compass);
        assert(after.flags == of_compass.flags && (after.flags & APLOMB_FLAG_VALID));
        assert(!(after.flags & APLOMB_FLAG_CALIBRATING));
        assert(fabsf(after.roll_rad - before.roll_rad) < 0.01f);
        assert(fabsf(after.body_rates_rad_s[1]) < 0.01f);
        float turned_rad = after.tilt_sigma_rad - before.tilt_sigma_rad;
        assert(age_us == 0 ? turned_rad < 0.01f : turned_rad > 0.1f);
    }
    for (size_t i = 0; i < sizeof damaged.bytes; i++) {
        damaged = start;
        damaged.bytes[i] ^= 0x10;
        assert(aplomb_resume(&pipeline, &damaged, 0, 0) == APLOMB_STATUS_NO_RECORD);
        assert(aplomb_compass_resume(&with_compass, &damaged, 0, 0) == APLOMB_STATUS_NO_RECORD);
    }
    assert(aplomb_warm_start(NULL, 0, &start) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_warm_start(&pipeline, 6000, NULL) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_resume(NULL, &start, 0, 0) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_resume(&pipeline, NULL, 0, 0) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_compass_warm_start(NULL, 0, &start) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_compass_warm_start(&with_compass, 6000, NULL) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_compass_resume(NULL, &start, 0, 0) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_compass_resume(&with_compass, NULL, 0, 0) == APLOMB_STATUS_NULL_POINTER);
}

static void null_pointers_are_refused(void)
{
    AplombSnapshot snapshot;
    AplombBurst burst;
    AplombSample sample;
    AplombField field;
    AplombCalibration calibration;
    AplombRecord record;
    AplombStatus none = APLOMB_STATUS_NULL_POINTER;
    fill(&burst, sizeof burst);
    fill(&sample, sizeof sample);
    fill(&field, sizeof field);
    fill(&calibration, sizeof calibration);
    assert(aplomb_update_burst(NULL, &burst, &snapshot) == none);
    assert(aplomb_update_burst(&pipeline, NULL, &snapshot) == none);
    assert(aplomb_update_burst(&pipeline, &burst, NULL) == none);
    assert(aplomb_update_sample(NULL, &sample, &snapshot) == none);
    assert(aplomb_update_sample(&pipeline, NULL, &snapshot) == none);
    assert(aplomb_update_sample(&pipeline, &sample, NULL) == none);
    assert(aplomb_stale(NULL, 0, &snapshot) == none);
    assert(aplomb_stale(&pipeline, 0, NULL) == none);
    assert(aplomb_set_armed(NULL, true) == none);
    assert(!aplomb_awaits_scale_check(NULL) && !aplomb_compass_awaits_scale_check(NULL));
    assert(aplomb_encode_record(&calibration, NULL) == none);
    assert(aplomb_decode_record(&record, NULL) == none);
    assert(aplomb_compass_update_burst(NULL, &burst, &snapshot) == none);
    assert(aplomb_compass_update_burst(&with_compass, NULL, &snapshot) == none);
    assert(aplomb_compass_update_burst(&with_compass, &burst, NULL) == none);
    assert(aplomb_compass_update_sample(NULL, &sample, &snapshot) == none);
    assert(aplomb_compass_update_sample(&with_compass, NULL, &snapshot) == none);
    assert(aplomb_compass_update_sample(&with_compass, &sample, NULL) == none);
    assert(aplomb_compass_update_field(NULL, &field) == none);
    assert(aplomb_compass_update_field(&with_compass, NULL) == none);
    assert(aplomb_compass_stale(NULL, 0, &snapshot) == none);
    assert(aplomb_compass_stale(&with_compass, 0, NULL) == none);
    assert(aplomb_compass_set_armed(NULL, true) == none);
}

static void memory_without_a_pipeline_is_refused(void)
{
    static AplombPipeline plain;
    static AplombCompassPipeline compass;
    AplombSettings settings = aplomb_default_settings();
    AplombSnapshot snapshot;
    AplombField field = {{0, 0, 0}, 0};
    for (int i = 0; i < 100; i++) {
        assert(aplomb_stale(&plain, 0, &snapshot) == APLOMB_STATUS_NOT_INITIALISED);
        assert(aplomb_compass_stale(&compass, 0, &snapshot) == APLOMB_STATUS_NOT_INITIALISED);
        assert(aplomb_compass_update_field(&compass, &field) == APLOMB_STATUS_NOT_INITIALISED);
        fill(&plain, sizeof plain);
        fill(&compass, sizeof compass);
    }
    /* A pipeline of one kind is none of the other. */
    assert(aplomb_init(&plain, &settings) == APLOMB_STATUS_OK);
    memcpy(&compass, &plain, sizeof plain);
    assert(aplomb_compass_stale(&compass, 0, &snapshot) == APLOMB_STATUS_NOT_INITIALISED);
    assert(aplomb_compass_init(&compass, &settings) == APLOMB_STATUS_OK);
    memcpy(&plain, &compass, sizeof plain);
    assert(aplomb_stale(&plain, 0, &snapshot) == APLOMB_STATUS_NOT_INITIALISED);
}

static bool is_finite(const AplombSnapshot *snapshot)
{
    for (int part = 0; part < 4; part++) {
        if (!isfinite(snapshot->attitude[part])) {
            return false;
        }
    }
    for (int axis = 0; axis < 3; axis++) {
        if (!isfinite(snapshot->body_rates_rad_s[axis])) {
            return false;
        }
    }
    return isfinite(snapshot->roll_rad) && isfinite(snapshot->pitch_rad) &&
           isfinite(snapshot->yaw_rad) && snapshot->tilt_sigma_rad >= 0.0f &&
           isfinite(snapshot->heading_rad) && isfinite(snapshot->yaw_offset_rad) &&
           snapshot->heading_sigma_rad >= 0.0f;
}

static bool is_calibrated_by_chance;

/* Updates both pipelines with any bytes, and a time that mostly goes on. */
static void update_by_chance(uint64_t *t_us)
{
    AplombSnapshot plain, compass;
    AplombBurst burst;
    AplombSample sample;
    AplombField field;
    fill(&burst, sizeof burst);
    fill(&sample, sizeof sample);
    fill(&field, sizeof field);
    *t_us += chance() % 2000;
    if (chance() % 8 != 0) {
        burst.captured_at_us = *t_us;
        sample.t_us = *t_us + 300;
    }
    assert(aplomb_update_burst(&pipeline, &burst, &plain) == APLOMB_STATUS_OK);
    assert(aplomb_compass_update_burst(&with_compass, &burst, &compass) == APLOMB_STATUS_OK);
    assert(is_finite(&plain) && is_finite(&compass));
    assert(memcmp(plain.attitude, compass.attitude, sizeof plain.attitude) == 0);
    assert(aplomb_update_sample(&pipeline, &sample, &plain) == APLOMB_STATUS_OK);
    assert(aplomb_compass_update_sample(&with_compass, &sample, &compass) == APLOMB_STATUS_OK);
    assert(is_finite(&plain) && is_finite(&compass));
    assert(memcmp(plain.attitude, compass.attitude, sizeof plain.attitude) == 0);
    float size = fabsf(field.field_ut[0]) + fabsf(field.field_ut[1]) + fabsf(field.field_ut[2]);
    bool is_used = size < 15000.0f && field.age_us <= 1000000;
    AplombStatus expected = is_used ? APLOMB_STATUS_OK : APLOMB_STATUS_WRONG_FIELD;
    AplombStatus status = aplomb_compass_update_field(&with_compass, &field);
    /* A calibration by chance changes the field. */
    assert(status == expected ||
           (is_calibrated_by_chance &&
            (status == APLOMB_STATUS_OK || status == APLOMB_STATUS_WRONG_FIELD)));
}

static void wild_inputs_give_finite_attitudes(void)
{
    AplombSettings settings = aplomb_default_settings();
    AplombSnapshot snapshot, of_copy;
    AplombPipeline copy;
    uint64_t t_us = 0;
    assert(aplomb_init(&pipeline, &settings) == APLOMB_STATUS_OK);
    assert(aplomb_compass_init(&with_compass, &settings) == APLOMB_STATUS_OK);
    assert(aplomb_set_armed(&pipeline, true) == APLOMB_STATUS_OK);
    assert(aplomb_compass_set_armed(&with_compass, true) == APLOMB_STATUS_OK);
    for (int i = 0; i < 20000; i++) {
        update_by_chance(&t_us);
    }
    /* A copy goes on as the original does. */
    copy = pipeline;
    t_us = UINT64_MAX; /* some times by chance are far in the future */
    assert(aplomb_stale(&pipeline, t_us, &snapshot) == APLOMB_STATUS_OK);
    assert(aplomb_stale(&copy, t_us, &of_copy) == APLOMB_STATUS_OK);
    assert(memcmp(snapshot.attitude, of_copy.attitude, sizeof snapshot.attitude) == 0);
}

static void a_silent_compass_gives_no_heading(void)
{
    AplombSettings settings = aplomb_default_settings();
    AplombSample sample = {0, {0.0f, 0.0f, 9.81f}, {0.0f, 0.0f, 0.0f}, 0, 0, 0};
    AplombSnapshot snapshot;
    assert(aplomb_compass_init(&with_compass, &settings) == APLOMB_STATUS_OK);
    for (uint64_t index = 1; index < 3000; index++) {
        sample.t_us = 1000 * index;
        assert(aplomb_compass_update_sample(&with_compass, &sample, &snapshot) ==
               APLOMB_STATUS_OK);
        assert(isinf(snapshot.heading_sigma_rad) && snapshot.heading_rad == 0.0f);
        assert((snapshot.flags & APLOMB_FLAG_HEADING_VALID) == 0);
    }
    assert(snapshot.flags & APLOMB_FLAG_VALID);
}

/* Any bytes as settings are refused with a status, or run. */
static void wild_settings_are_refused_or_run(void)
{
    AplombSettings usual = aplomb_default_settings();
    int refused = 0, run = 0;
    is_calibrated_by_chance = true;
    for (int i = 0; i < 3000; i++) {
        AplombSettings settings = usual;
        AplombStatus status;
        AplombStep step;
        uint64_t t_us = 0;
        size_t start = chance() % sizeof settings;
        size_t size = chance() % (sizeof settings - start + 1);
        fill((unsigned char *)&settings + start, size);
        if (i % 2 == 0) { /* with names and ranges that are right */
            AplombCalibration any = settings.calibration;
            settings = usual;
            settings.calibration = any;
            memcpy(settings.calibration.mount, usual.calibration.mount, 8);
            memcpy(settings.calibration.compass_mount, usual.calibration.compass_mount, 8);
        }
        (void)aplomb_configuration_step(&settings, chance(), &step);
        status = aplomb_compass_init(&with_compass, &settings);
        if (status != APLOMB_STATUS_OK || aplomb_init(&pipeline, &settings) != APLOMB_STATUS_OK) {
            assert(status <= APLOMB_STATUS_WRONG_TEMPERATURE_RANGE ||
                   status == APLOMB_STATUS_WRONG_COMPASS);
            refused++;
            continue;
        }
        run++;
        for (int update = 0; update < 20; update++) {
            update_by_chance(&t_us);
        }
    }
    assert(refused > 500 && run > 500);
}

int main(void)
{
    settings_are_checked();
    a_failed_start_leaves_no_pipeline();
    settings_of_a_compass_are_checked();
    steps_are_those_of_the_datasheet();
    a_restoration_and_the_checks_are_those_of_the_datasheet();
    records_read_back();
    calibrations_that_no_sensor_has_are_refused();
    samples_give_the_attitudes_of_their_bursts();
    a_rate_jump_waits_for_the_full_scales();
    samples_wait_for_the_full_scales_too();
    a_stale_time_before_the_last_sample_is_refused();
    fields_that_no_compass_gives_are_refused();
    a_run_keeps_what_it_has_learned();
    a_run_goes_on_after_a_reset();
    null_pointers_are_refused();
    memory_without_a_pipeline_is_refused();
    wild_inputs_give_finite_attitudes();
    a_silent_compass_gives_no_heading();
    wild_settings_are_refused_or_run();
    printf("aplomb %s: all passed\n", aplomb_version());
    return 0;
}
