/* Checks each function at its boundary: null pointers, wrong settings, wild values, records. */
#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "aplomb.h"

static AplombPipeline pipeline;
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
    wrong.accelerometer_knowledge = 4;
    assert(aplomb_init(&pipeline, &wrong) == APLOMB_STATUS_WRONG_KNOWLEDGE);
    for (uint32_t status = 0; status < 12; status++) {
        assert(strlen(aplomb_status_text(status)) > 3);
    }
    assert(aplomb_status_text(0xFFFFFFFFu) != NULL);
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

static void records_read_back(void)
{
    AplombCalibration calibration, found;
    AplombRecord record;
    memset(&calibration, 0, sizeof calibration);
    calibration.has_accelerometer = true;
    calibration.accelerometer_offset_m_s2[1] = 0.25f;
    for (int i = 0; i < 3; i++) {
        calibration.accelerometer_matrix[i] = 1.0f;
    }
    assert(aplomb_encode_record(&calibration, &record) == APLOMB_STATUS_OK);
    assert(aplomb_decode_record(&record, &found) == APLOMB_STATUS_OK);
    assert(found.has_accelerometer && !found.has_level && !found.has_gyroscope);
    assert(found.accelerometer_offset_m_s2[1] == 0.25f && found.accelerometer_matrix[2] == 1.0f);
    record.bytes[40] ^= 1;
    assert(aplomb_decode_record(&record, &found) == APLOMB_STATUS_NO_RECORD);
    for (int i = 0; i < 2000; i++) {
        fill(&record, sizeof record);
        assert(aplomb_decode_record(&record, &found) == APLOMB_STATUS_NO_RECORD);
    }
    calibration.accelerometer_offset_m_s2[0] = NAN;
    assert(aplomb_encode_record(&calibration, &record) == APLOMB_STATUS_NOT_STORABLE);
    assert(aplomb_encode_record(NULL, &record) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_decode_record(NULL, &found) == APLOMB_STATUS_NULL_POINTER);
}

static void wild_inputs_give_finite_attitudes(void)
{
    AplombSettings settings = aplomb_default_settings();
    AplombSnapshot snapshot;
    AplombPipeline copy;
    memset(&copy, 0, sizeof copy);
    assert(aplomb_stale(&copy, 0, &snapshot) == APLOMB_STATUS_NOT_INITIALISED);
    assert(aplomb_set_armed(NULL, true) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_init(&pipeline, &settings) == APLOMB_STATUS_OK);
    assert(aplomb_set_armed(&pipeline, true) == APLOMB_STATUS_OK);
    assert(aplomb_update_burst(&pipeline, NULL, &snapshot) == APLOMB_STATUS_NULL_POINTER);
    assert(aplomb_update_sample(&pipeline, NULL, &snapshot) == APLOMB_STATUS_NULL_POINTER);
    for (int i = 0; i < 20000; i++) {
        AplombBurst burst;
        AplombSample sample;
        fill(&burst, sizeof burst);
        assert(aplomb_update_burst(&pipeline, &burst, &snapshot) == APLOMB_STATUS_OK);
        fill(&sample.t_us, sizeof sample.t_us);
        fill(sample.specific_force_m_s2, sizeof sample.specific_force_m_s2);
        fill(sample.angular_rate_rad_s, sizeof sample.angular_rate_rad_s);
        sample.is_force_saturated = chance() & 1;
        sample.is_rate_saturated = chance() & 1;
        assert(aplomb_update_sample(&pipeline, &sample, &snapshot) == APLOMB_STATUS_OK);
        for (int part = 0; part < 4; part++) {
            assert(isfinite(snapshot.attitude[part]));
        }
    }
    /* A copy goes on as the original does. */
    copy = pipeline;
    AplombSnapshot of_copy;
    assert(aplomb_stale(&pipeline, 1, &snapshot) == APLOMB_STATUS_OK);
    assert(aplomb_stale(&copy, 1, &of_copy) == APLOMB_STATUS_OK);
    assert(memcmp(snapshot.attitude, of_copy.attitude, sizeof snapshot.attitude) == 0);
}

int main(void)
{
    settings_are_checked();
    steps_are_those_of_the_datasheet();
    records_read_back();
    wild_inputs_give_finite_attitudes();
    printf("aplomb %s: all passed\n", aplomb_version());
    return 0;
}
