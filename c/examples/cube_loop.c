/* A main loop with the calls of CubeMX: find and configure the sensor once, read it at each edge,
 * and restore it when it has reset itself or has lost a setting.
 *
 * Call attitude_start before the loop and attitude_poll in it. In stm32f4xx_it.c the handler of
 * the INT pin calls attitude_edge. All three get the count of one 32-bit timer at 1 MHz, such as
 * __HAL_TIM_GET_COUNTER(&htim5). Only attitude_start waits for the sensor; each transfer blocks for
 * 2 ms at most. */
#include "cube_loop.h"

#include <stddef.h>

#include "aplomb.h"
#include "hal.h"

#define SENSOR (0x68 << 1)
#define WHO_AM_I 0x75
#define DATA 0x3B
#define TIMEOUT_MS 2
#define BURSTS_TO_CHECK 44
#define SILENCE_US 3000u /* three periods of the samples */
#define SILENCES_TO_RESET 100

/* List of the steps that configure the sensor. */
typedef AplombStatus (*Steps)(const AplombSettings *, uint32_t, AplombStep *);

static AplombPipeline pipeline;
static AplombSettings settings;
static volatile uint32_t edge_count_us, edges;
/* Number of the last edge that was handled, and of the last one with a burst. */
static uint32_t handled, read_last;
/* Time of the last count, and of the last attitude. */
static uint64_t latest_us, published_us;
/* Flags of the next burst. */
static uint32_t flags;
/* Steps that are being written, or NULL; the next of them, and its time. */
static Steps restoring;
static uint32_t next_step;
static uint64_t next_step_us;

/* Extends a count, which wraps every 71.6 minutes, to 64 bits. It may be older than the last one:
 * an edge is handled later than it came. */
static uint64_t extended(uint32_t count_us)
{
    latest_us += (uint64_t)(int64_t)(int32_t)(count_us - (uint32_t)latest_us);
    return latest_us;
}

static bool read_registers(uint8_t address, uint8_t *bytes, uint16_t length)
{
    return HAL_I2C_Mem_Read(&hi2c1, SENSOR, address, 1, bytes, length, TIMEOUT_MS) == HAL_OK;
}

static bool write_step(AplombStep *step)
{
    return HAL_I2C_Mem_Write(&hi2c1, SENSOR, step->register_address, 1, &step->value, 1,
                             TIMEOUT_MS) == HAL_OK;
}

/* Reads the settings back. A short loss of supply changes them, and the rates are wrong then.
 * Returns the flag for the next burst. */
static uint32_t check_settings(void)
{
    AplombCheck check;
    for (uint32_t i = 0; aplomb_settings_check(&settings, i, &check) == APLOMB_STATUS_OK; i++) {
        uint8_t found[APLOMB_CHECK_BYTES];
        if (!read_registers(check.register_address, found, check.length)) {
            return APLOMB_FLAG_BUS_FAULT;
        }
        for (uint8_t byte = 0; byte < check.length; byte++) {
            if ((found[byte] & check.masks[byte]) != check.values[byte]) {
                return APLOMB_FLAG_SENSOR_RESET;
            }
        }
    }
    return APLOMB_FLAG_SCALES_VERIFIED;
}

/* Finds and configures the sensor. Returns false if no known one answers. */
bool attitude_start(uint32_t count_us)
{
    AplombStep step;
    latest_us = published_us = count_us;
    flags = 0;
    restoring = NULL;
    settings = aplomb_default_settings();
    settings.verifies_scales = 1; /* attitude_poll does */
    if (!read_registers(WHO_AM_I, &settings.who_am_i, 1) ||
        aplomb_init(&pipeline, &settings) != APLOMB_STATUS_OK) {
        return false;
    }
    for (uint32_t i = 0; aplomb_configuration_step(&settings, i, &step) == APLOMB_STATUS_OK; i++) {
        if (!write_step(&step)) {
            return false;
        }
        HAL_Delay(step.wait_ms);
    }
    handled = read_last = edges;
    return check_settings() == APLOMB_FLAG_SCALES_VERIFIED;
}

/* Notes the time of an edge. */
void attitude_edge(uint32_t count_us)
{
    edge_count_us = count_us;
    edges = edges + 1;
}

/* Writes the next step of a restoration once its time has come. */
static void restore(uint64_t now_us)
{
    AplombStep step;
    uint32_t found;
    if (now_us < next_step_us) {
        return;
    }
    if (restoring(&settings, next_step, &step) == APLOMB_STATUS_OK) {
        if (write_step(&step)) {
            next_step++;
            next_step_us = now_us + 1000u * step.wait_ms;
        } else {
            next_step = 0;
            next_step_us = now_us + SILENCE_US;
            flags |= APLOMB_FLAG_BUS_FAULT;
        }
        return;
    }
    found = check_settings();
    flags |= APLOMB_FLAG_SENSOR_RESET | found;
    handled = edges; /* those in between had wrong settings */
    next_step = 0;
    restoring = found == APLOMB_FLAG_SCALES_VERIFIED ? NULL : aplomb_configuration_step;
}

static void begin(Steps steps)
{
    restoring = steps;
    next_step = 0;
    next_step_us = 0;
}

/* Reads the sensor after an edge. Returns true if there is a new attitude. */
static bool read_sensor(AplombSnapshot *snapshot)
{
    static uint32_t bursts;
    AplombBurst burst = {0};
    uint32_t lost, count_us;
    do { /* several loads: an edge may come between them */
        handled = edges;
        count_us = edge_count_us;
    } while (handled != edges);
    burst.captured_at_us = extended(count_us);
    if (!read_registers(DATA, burst.bytes, 14)) {
        flags |= APLOMB_FLAG_BUS_FAULT; /* one lost sample does no harm */
        return false;
    }
    lost = handled - read_last - 1; /* edges that came too fast, and failed reads */
    read_last = handled;
    burst.missed_before = (uint8_t)(lost < 255 ? lost : 255);
    burst.board_flags = flags;
    if (aplomb_update_burst(&pipeline, &burst, snapshot) != APLOMB_STATUS_OK) {
        return false;
    }
    /* After a jump of the rate no attitude is valid before the settings are checked. */
    flags = 0;
    if (++bursts % BURSTS_TO_CHECK == 0 || aplomb_awaits_scale_check(&pipeline)) {
        flags = check_settings();
        if (flags == APLOMB_FLAG_SENSOR_RESET) {
            begin(aplomb_reconfiguration_step);
        }
    }
    return true;
}

/* Reads the sensor after an edge. Returns true if there is an attitude: a new one, or without
 * samples every 3 ms the last one, which is flagged STALE. */
bool attitude_poll(uint32_t count_us, AplombSnapshot *snapshot)
{
    static uint32_t silences;
    uint64_t now_us = extended(count_us);
    if (restoring != NULL) {
        restore(now_us);
    } else if (edges != handled && read_sensor(snapshot)) {
        published_us = now_us;
        silences = 0;
        return true;
    }
    if (now_us - published_us < SILENCE_US) {
        return false;
    }
    published_us = now_us;
    if (restoring == NULL) { /* a sensor that has reset itself gives no edges */
        uint32_t found = check_settings();
        bool is_reset = found == APLOMB_FLAG_SENSOR_RESET;
        flags |= found & APLOMB_FLAG_BUS_FAULT;
        if (is_reset || ++silences % SILENCES_TO_RESET == 0) {
            begin(is_reset ? aplomb_reconfiguration_step : aplomb_configuration_step);
        }
    }
    return aplomb_stale(&pipeline, now_us, snapshot) == APLOMB_STATUS_OK;
}
