/* A main loop with the calls of CubeMX: configure the sensor once, then read it at each edge.
 *
 * Call attitude_start before the loop and attitude_poll in it. In stm32f4xx_it.c the handler of
 * the INT pin calls attitude_edge. */
#include "cube_loop.h"

#include "aplomb.h"
#include "hal.h"

#define SENSOR (0x68 << 1)
#define DATA 0x3B

static AplombPipeline pipeline;
static volatile uint64_t edge_us;
static volatile bool has_edge;

/* Configures the sensor. Returns false if it does not answer. */
bool attitude_start(void)
{
    AplombSettings settings = aplomb_default_settings();
    AplombStep step;
    for (uint32_t i = 0; aplomb_configuration_step(&settings, i, &step) == APLOMB_STATUS_OK; i++) {
        if (HAL_I2C_Mem_Write(&hi2c1, SENSOR, step.register_address, 1, &step.value, 1, 10) !=
            HAL_OK) {
            return false;
        }
        HAL_Delay(step.wait_ms);
    }
    return aplomb_init(&pipeline, &settings) == APLOMB_STATUS_OK;
}

/* Notes the time of an edge, in microseconds since start. */
void attitude_edge(uint64_t now_us)
{
    edge_us = now_us;
    has_edge = true;
}

/* Reads the sensor after an edge. Returns true if there is a new attitude. */
bool attitude_poll(AplombSnapshot *snapshot)
{
    static uint8_t failed;
    AplombBurst burst = {0};
    if (!has_edge) {
        return false;
    }
    has_edge = false;
    do { /* two loads: an edge may come between them */
        burst.captured_at_us = edge_us;
    } while (burst.captured_at_us != edge_us);
    burst.missed_before = failed;
    if (HAL_I2C_Mem_Read(&hi2c1, SENSOR, DATA, 1, burst.bytes, 14, 2) != HAL_OK) {
        failed = (uint8_t)(failed < 255 ? failed + 1 : 255); /* one lost sample does no harm */
        return false;
    }
    if (failed > 0) {
        burst.board_flags = APLOMB_FLAG_BUS_FAULT;
    }
    failed = 0;
    return aplomb_update_burst(&pipeline, &burst, snapshot) == APLOMB_STATUS_OK;
}
