/* A main loop with the calls of CubeMX: configure the sensor once, then read it at each edge.
 *
 * Call attitude_start before the loop and attitude_poll in it. In stm32f4xx_it.c the handler of
 * the INT pin calls attitude_edge. */
#include "cube_loop.h"

#include <string.h>

#include "aplomb.h"
#include "hal.h"

#define SENSOR (0x68 << 1)
#define DATA 0x3B
#define FIRST_SETTING 0x19 /* rate, low-pass filter, both ranges */
#define SETTINGS 4
#define BURSTS_TO_CHECK 44

static AplombPipeline pipeline;
static AplombSettings settings;
static uint8_t wanted[SETTINGS];
static volatile uint64_t edge_us;
static volatile uint32_t edges;
/* Number of the last edge that was handled, and of the last one with a burst. */
static uint32_t handled, read_last;

/* Writes the settings to the sensor. Returns false if it does not answer. */
static bool configure(void)
{
    AplombStep step;
    for (uint32_t i = 0; aplomb_configuration_step(&settings, i, &step) == APLOMB_STATUS_OK; i++) {
        if (HAL_I2C_Mem_Write(&hi2c1, SENSOR, step.register_address, 1, &step.value, 1, 10) !=
            HAL_OK) {
            return false;
        }
        if (step.register_address >= FIRST_SETTING &&
            step.register_address < FIRST_SETTING + SETTINGS) {
            wanted[step.register_address - FIRST_SETTING] = step.value;
        }
        HAL_Delay(step.wait_ms);
    }
    return true;
}

/* Configures the sensor. Returns false if it does not answer. */
bool attitude_start(void)
{
    settings = aplomb_default_settings();
    settings.verifies_scales = 1; /* attitude_poll does */
    if (!configure()) {
        return false;
    }
    handled = read_last = edges;
    return aplomb_init(&pipeline, &settings) == APLOMB_STATUS_OK;
}

/* Notes the time of an edge, in microseconds since start. */
void attitude_edge(uint64_t now_us)
{
    edge_us = now_us;
    edges = edges + 1;
}

/* Reads the settings back. A short loss of supply changes them, and the rates are wrong then.
 * Restores them if need be, and returns the flag for the next burst. */
static uint32_t check_settings(void)
{
    uint8_t found[SETTINGS];
    if (HAL_I2C_Mem_Read(&hi2c1, SENSOR, FIRST_SETTING, 1, found, SETTINGS, 2) != HAL_OK) {
        return APLOMB_FLAG_BUS_FAULT;
    }
    if (memcmp(found, wanted, SETTINGS) == 0) {
        return APLOMB_FLAG_SCALES_VERIFIED;
    }
    configure();
    return APLOMB_FLAG_SENSOR_RESET;
}

/* Reads the sensor after an edge. Returns true if there is a new attitude. */
bool attitude_poll(AplombSnapshot *snapshot)
{
    static uint32_t flags, bursts;
    AplombBurst burst = {0};
    uint32_t lost;
    if (edges == handled) {
        return false;
    }
    do { /* several loads: an edge may come between them */
        handled = edges;
        burst.captured_at_us = edge_us;
    } while (handled != edges);
    if (HAL_I2C_Mem_Read(&hi2c1, SENSOR, DATA, 1, burst.bytes, 14, 2) != HAL_OK) {
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
    }
    return true;
}
