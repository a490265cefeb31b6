/* Runs the examples for a main loop and for a scheduler, against a sensor that is played. */
#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "cube_loop.h"
#include "hal.h"
#include "scheduler_task.h"

I2C_HandleTypeDef hi2c1;

static int writes, waited_ms, reads;
static uint8_t registers[256];
static int rate_deg_s;

HAL_StatusTypeDef HAL_I2C_Mem_Write(I2C_HandleTypeDef *port, uint16_t device, uint16_t address,
                                    uint16_t address_size, uint8_t *data, uint16_t size,
                                    uint32_t timeout_ms)
{
    (void)timeout_ms;
    assert(port == &hi2c1 && device == 0xD0 && address_size == 1 && size == 1);
    registers[address & 0xFF] = *data;
    writes++;
    return HAL_OK;
}

/* Level, face up, turning about down at `rate_deg_s`, with a little noise. The tenth read fails. */
HAL_StatusTypeDef HAL_I2C_Mem_Read(I2C_HandleTypeDef *port, uint16_t device, uint16_t address,
                                   uint16_t address_size, uint8_t *data, uint16_t size,
                                   uint32_t timeout_ms)
{
    static const uint8_t level[14] = {0, 3, 0, 4, 8, 0, 0xF0, 0xB0};
    (void)device, (void)address_size, (void)timeout_ms;
    assert(port == &hi2c1);
    if (address != 0x3B) {
        memcpy(data, registers + address, size);
        return HAL_OK;
    }
    assert(size == 14);
    if (++reads == 10) {
        return HAL_ERROR;
    }
    memcpy(data, level, 14);
    data[1] = (uint8_t)(reads % 7);
    /* Full scale is 250, 500, 1000 or 2000 degrees per second. */
    int counts = rate_deg_s * (131 >> (registers[0x1B] >> 3)) + reads % 3;
    data[12] = (uint8_t)(counts >> 8);
    data[13] = (uint8_t)counts;
    return HAL_OK;
}

void HAL_Delay(uint32_t ms)
{
    waited_ms += (int)ms;
}

int main(void)
{
    AplombSnapshot snapshot;
    uint32_t seen = 0;
    assert(attitude_start() && writes == 10 && waited_ms == 230);
    assert(!attitude_poll(&snapshot));
    for (uint64_t now_us = 1000; now_us < 3000000; now_us += 1000) {
        attitude_edge(now_us);
        assert(attitude_poll(&snapshot) == (reads != 10));
        seen |= snapshot.flags;
    }
    assert((snapshot.flags & APLOMB_FLAG_VALID) && (seen & APLOMB_FLAG_BUS_FAULT));
    assert(writes == 10 && !(seen & APLOMB_FLAG_SENSOR_RESET));
    assert(!(snapshot.flags & APLOMB_FLAG_MISSED));

    /* Two edges before a poll: a sample is lost. */
    attitude_edge(3000000);
    attitude_edge(3001000);
    assert(attitude_poll(&snapshot) && (snapshot.flags & APLOMB_FLAG_MISSED));
    assert(!attitude_poll(&snapshot));

    /* The full scale of the gyroscope is lost: it is restored, and reported. */
    registers[0x1B] = 0;
    seen = 0;
    for (uint64_t now_us = 3002000; now_us < 3050000; now_us += 1000) {
        attitude_edge(now_us);
        assert(attitude_poll(&snapshot));
        seen |= snapshot.flags;
    }
    assert(registers[0x1B] == 0x18 && (seen & APLOMB_FLAG_SENSOR_RESET));
    assert(fabsf(snapshot.roll_rad) < 0.01f && fabsf(snapshot.pitch_rad) < 0.01f);

    /* In a turn the rate jumps: no wrong attitude is valid, and the next poll restores the scale. */
    uint64_t turning_us = 3050000;
    for (; turning_us < 3094000; turning_us += 1000) {
        rate_deg_s = (int)(turning_us - 3050000) / 4000;
        attitude_edge(turning_us);
        assert(attitude_poll(&snapshot) && (snapshot.flags & APLOMB_FLAG_VALID));
    }
    registers[0x1B] = 0;
    attitude_edge(turning_us);
    assert(attitude_poll(&snapshot) && !(snapshot.flags & APLOMB_FLAG_VALID));
    assert(registers[0x1B] == 0x18);
    attitude_edge(turning_us + 1000);
    assert(attitude_poll(&snapshot) && (snapshot.flags & APLOMB_FLAG_SENSOR_RESET));

    const float force[3] = {0.0f, 4.903f, 8.493f}, rate[3] = {0.0f, 0.0f, 0.0f};
    bool is_valid = false;
    assert(!attitude_init(2) && attitude_init(200));
    for (uint64_t now_us = 5000; now_us < 4000000; now_us += 5000) {
        is_valid = attitude_task(now_us, force, rate, &snapshot);
    }
    assert(is_valid && fabsf(snapshot.roll_rad - 0.5236f) < 0.01f);
    printf("roll %.2f rad, sigma %.3f rad\n", (double)snapshot.roll_rad,
           (double)snapshot.tilt_sigma_rad);
    return 0;
}
