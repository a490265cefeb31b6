/* Runs the examples for a main loop and for a scheduler, against a sensor that is played. */
#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "cube_loop.h"
#include "hal.h"
#include "scheduler_task.h"

/* Time between two polls of the main loop, us. */
#define POLL_US 250

I2C_HandleTypeDef hi2c1;

static int writes, device_resets, waited_ms, reads;
static bool is_absent, is_hung;
static uint8_t registers[256];
static int rate_deg_s;
/* Sum of the flags of all attitudes since it was cleared; time of the loop, and of the last new
 * and the last stale attitude. */
static uint32_t seen;
static uint64_t now_us, new_us, stale_us;
static AplombSnapshot snapshot;

/* A sensor after power-up: asleep, without interrupts. An MPU-6500 is awake. */
static void reset_sensor(void)
{
    uint8_t who_am_i = registers[0x75];
    memset(registers, 0, sizeof registers);
    registers[0x75] = who_am_i;
    registers[0x6B] = who_am_i == 0x68 ? 0x40 : 0x01;
}

HAL_StatusTypeDef HAL_I2C_Mem_Write(I2C_HandleTypeDef *port, uint16_t device, uint16_t address,
                                    uint16_t address_size, uint8_t *data, uint16_t size,
                                    uint32_t timeout_ms)
{
    (void)timeout_ms;
    assert(port == &hi2c1 && device == 0xD0 && address_size == 1 && size == 1);
    if (is_absent) {
        return HAL_ERROR;
    }
    writes++;
    if (address == 0x6B && *data == 0x80) {
        device_resets++;
        is_hung = false;
        reset_sensor();
        return HAL_OK;
    }
    registers[address & 0xFF] = *data;
    return HAL_OK;
}

/* Level, face up, turning about down at `rate_deg_s`, with a little noise. The tenth read fails. */
HAL_StatusTypeDef HAL_I2C_Mem_Read(I2C_HandleTypeDef *port, uint16_t device, uint16_t address,
                                   uint16_t address_size, uint8_t *data, uint16_t size,
                                   uint32_t timeout_ms)
{
    static const uint8_t level[14] = {0, 3, 0, 4, 8, 0, 0xF0, 0xB0};
    static uint32_t noise = 1;
    (void)device, (void)address_size, (void)timeout_ms;
    assert(port == &hi2c1);
    if (is_absent) {
        return HAL_ERROR;
    }
    if (address != 0x3B) {
        memcpy(data, registers + address, size);
        return HAL_OK;
    }
    assert(size == 14);
    if (++reads == 10) {
        return HAL_ERROR;
    }
    memcpy(data, level, 14);
    for (int axis = 0; axis < 7; axis++) { /* one that repeats would count as stuck */
        noise = noise * 1664525u + 1013904223u;
        data[2 * axis + 1] = (uint8_t)(level[2 * axis + 1] + (noise >> 16) % 5);
    }
    /* Full scale is 250, 500, 1000 or 2000 degrees per second. */
    int counts = rate_deg_s * (131 >> (registers[0x1B] >> 3)) + (int)((noise >> 20) % 3);
    data[12] = (uint8_t)(counts >> 8);
    data[13] = (uint8_t)counts;
    return HAL_OK;
}

void HAL_Delay(uint32_t ms)
{
    waited_ms += (int)ms;
}

/* Runs the main loop for this time. An awake sensor with its interrupt gives an edge a millisecond,
 * just before a poll. */
static void run_ms(uint32_t duration_ms)
{
    uint64_t end_us = now_us + 1000u * duration_ms;
    for (; now_us < end_us; now_us += POLL_US) {
        bool is_awake = !is_absent && registers[0x38] == 1 && (registers[0x6B] & 0x40) == 0;
        if (is_awake && !is_hung && now_us % 1000 == 0) {
            attitude_edge((uint32_t)now_us - 100);
        }
        if (attitude_poll((uint32_t)now_us, &snapshot)) {
            bool is_stale = (snapshot.flags & APLOMB_FLAG_STALE) != 0;
            *(is_stale ? &stale_us : &new_us) = now_us;
            seen |= snapshot.flags;
        }
    }
}

static void an_attitude_comes_with_each_edge(void)
{
    uint64_t start_us = now_us;
    int before = writes;
    reads = 0;
    stale_us = seen = 0;
    run_ms(3000);
    assert((snapshot.flags & APLOMB_FLAG_VALID) && (seen & APLOMB_FLAG_BUS_FAULT));
    assert(writes == before && reads == 3000 && stale_us == 0);
    assert(!(seen & (APLOMB_FLAG_SENSOR_RESET | APLOMB_FLAG_TIME | APLOMB_FLAG_GAP)));
    /* The time goes on where the timer of 32 bits wraps. */
    assert(snapshot.t_us == start_us + 2999000 - 100);

    /* Two edges before a poll: a sample is lost. */
    attitude_edge((uint32_t)now_us - 200);
    attitude_edge((uint32_t)now_us - 100);
    assert(attitude_poll((uint32_t)now_us, &snapshot) && (snapshot.flags & APLOMB_FLAG_MISSED));
    assert(!attitude_poll((uint32_t)now_us, &snapshot));
    now_us += 1000;
}

/* Each setting that is lost is noticed, and restored without a device reset and without a wait. */
static void a_lost_setting_is_restored(void)
{
    static const uint8_t addresses[] = {0x19, 0x1A, 0x1B, 0x1C, 0x1D, 0x37, 0x38, 0x6B, 0x6C};
    for (size_t i = 0; i < sizeof addresses; i++) {
        uint8_t address = addresses[i], right = registers[address];
        int resets = device_resets, waits = waited_ms, before = writes;
        if (address == 0x1D && registers[0x75] == 0x68) {
            continue; /* it has no such register */
        }
        seen = 0;
        registers[address] = (uint8_t)(right ^ (address >= 0x38 ? 0x41 : 0x03 << 3 | 0x01));
        run_ms(100);
        assert(registers[address] == right && (seen & APLOMB_FLAG_SENSOR_RESET));
        assert(device_resets == resets && waited_ms == waits && writes - before < 11);
        assert((snapshot.flags & APLOMB_FLAG_VALID) && now_us - new_us <= 1000);
        assert(fabsf(snapshot.roll_rad) < 0.01f && fabsf(snapshot.pitch_rad) < 0.01f);
    }
}

/* A sensor that has reset itself gives no edges: the attitude grows stale, and the settings are
 * restored. */
static void a_sensor_that_resets_itself_comes_back(void)
{
    int resets = device_resets, waits = waited_ms;
    uint64_t reset_us = now_us;
    float sigma_rad = snapshot.tilt_sigma_rad;
    seen = 0;
    stale_us = 0;
    reset_sensor();
    run_ms(4);
    assert(stale_us > reset_us && (snapshot.flags & APLOMB_FLAG_STALE));
    assert(!(snapshot.flags & APLOMB_FLAG_VALID));
    run_ms(4);
    assert(snapshot.tilt_sigma_rad > sigma_rad);
    run_ms(32);
    assert(new_us > reset_us && (seen & APLOMB_FLAG_SENSOR_RESET));
    assert(device_resets == resets && waited_ms == waits);
    run_ms(100);
    assert(snapshot.flags & APLOMB_FLAG_VALID);
}

/* A sensor without supply for a second gives stale attitudes all the time, and comes back. */
static void a_sensor_that_was_absent_comes_back(void)
{
    int waits = waited_ms;
    is_absent = true;
    reset_sensor();
    seen = 0;
    for (int i = 0; i < 100; i++) {
        run_ms(10);
        assert((snapshot.flags & APLOMB_FLAG_STALE) && now_us - stale_us <= 3000 + POLL_US);
    }
    is_absent = false;
    run_ms(400);
    assert(now_us - new_us <= 1000 && (seen & APLOMB_FLAG_BUS_FAULT));
    run_ms(2000);
    assert((snapshot.flags & APLOMB_FLAG_VALID) && waited_ms == waits);
}

/* A sensor with right settings, but without samples, gets a device reset. */
static void a_sensor_that_hangs_is_reset(void)
{
    int waits = waited_ms;
    is_hung = true;
    run_ms(600);
    assert(!is_hung && now_us - new_us <= 1000);
    run_ms(2000);
    assert((snapshot.flags & APLOMB_FLAG_VALID) && waited_ms == waits);
}

/* In a turn the full scale is lost, and the rate jumps: no wrong attitude is valid. */
static void a_rate_jump_restores_the_full_scale(void)
{
    for (rate_deg_s = 0; rate_deg_s < 11; rate_deg_s++) {
        run_ms(4);
        assert(snapshot.flags & APLOMB_FLAG_VALID);
    }
    registers[0x1B] = 0;
    for (int i = 0; registers[0x1B] == 0; i++) {
        assert(i < 35); /* the steps take 30 */
        run_ms(1);
        assert(!(snapshot.flags & APLOMB_FLAG_VALID));
    }
    seen = 0;
    run_ms(5);
    assert(registers[0x1B] == 0x18 && (seen & APLOMB_FLAG_SENSOR_RESET));
    run_ms(50);
    assert(snapshot.flags & APLOMB_FLAG_VALID);
    rate_deg_s = 0;
    run_ms(1000);
}

static void a_main_loop_runs(uint8_t who_am_i, uint32_t count_us)
{
    int before_ms = waited_ms;
    now_us = count_us;
    registers[0x75] = who_am_i;
    assert(attitude_start(count_us) && waited_ms - before_ms == 230);
    assert(!attitude_poll(count_us, &snapshot));
    now_us += 1000;
    an_attitude_comes_with_each_edge();
    a_lost_setting_is_restored();
    a_sensor_that_resets_itself_comes_back();
    a_sensor_that_was_absent_comes_back();
    a_sensor_that_hangs_is_reset();
    a_rate_jump_restores_the_full_scale();
}

static void a_task_of_a_scheduler_runs(uint16_t samples_per_s)
{
    const float force[3] = {0.0f, 4.903f, 8.493f}, rate[3] = {0.0f, 0.0f, 0.0f};
    uint64_t period_us = 1000000u / samples_per_s, t_us = 0;
    bool is_valid = false;
    float sigma_rad;
    assert(attitude_init(samples_per_s));
    for (uint32_t i = 0; i < 4u * samples_per_s; i++) {
        t_us += period_us;
        is_valid = attitude_task(t_us, force, rate, &snapshot);
    }
    assert(is_valid && fabsf(snapshot.roll_rad - 0.5236f) < 0.01f);
    /* A pause of more than 3.5 periods adds to sigma; one of three does not. */
    sigma_rad = snapshot.tilt_sigma_rad;
    t_us += 3 * period_us;
    attitude_task(t_us, force, rate, &snapshot);
    assert(fabsf(snapshot.tilt_sigma_rad - sigma_rad) < 1e-6f);
    t_us += 4 * period_us;
    attitude_task(t_us, force, rate, &snapshot);
    assert(snapshot.tilt_sigma_rad > sigma_rad + 1e-6f);
}

int main(void)
{
    /* In the second run the timer wraps after 1.5 s. */
    assert(!attitude_start(0)); /* no part has the identity 0 */
    a_main_loop_runs(0x68, 0);
    a_main_loop_runs(0x70, 4293467000u);

    assert(!attitude_init(2) && !attitude_init(8001));
    a_task_of_a_scheduler_runs(50);
    a_task_of_a_scheduler_runs(200);
    a_task_of_a_scheduler_runs(1000);
    a_task_of_a_scheduler_runs(1600);
    a_task_of_a_scheduler_runs(2000);
    a_task_of_a_scheduler_runs(8000);
    printf("roll %.2f rad, sigma %.3f rad\n", (double)snapshot.roll_rad,
           (double)snapshot.tilt_sigma_rad);
    return 0;
}
