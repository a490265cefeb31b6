/* A task of a scheduler, as flight stacks have it: the sensor's driver delivers SI units. */
#include "scheduler_task.h"

static AplombPipeline pipeline;

/* Starts the filter for samples at this rate, 4 to 8,000 a second. */
bool attitude_init(uint16_t samples_per_s)
{
    AplombSettings settings = aplomb_default_settings();
    uint16_t rate = 1000;
    if (samples_per_s < 4 || samples_per_s > 8000) {
        return false;
    }
    if (samples_per_s > 1000) { /* such as 1,600 or 2,000 */
        settings.low_pass_hz = 256;
        rate = 8000;
    }
    settings.sample_rate_divider = (uint8_t)(rate / samples_per_s - 1);
    settings.sensor_delay_us = 0; /* the time is that of the sample */
    return aplomb_init(&pipeline, &settings) == APLOMB_STATUS_OK;
}

/* Takes m/s2 and rad/s in the sensor's axes. Writes the attitude. Returns true if it is valid. */
bool attitude_task(uint64_t now_us, const float force[3], const float rate[3], AplombSnapshot *out)
{
    AplombSample sample = {0};
    sample.t_us = now_us;
    for (int axis = 0; axis < 3; axis++) {
        sample.specific_force_m_s2[axis] = force[axis];
        sample.angular_rate_rad_s[axis] = rate[axis];
    }
    return aplomb_update_sample(&pipeline, &sample, out) == APLOMB_STATUS_OK &&
           (out->flags & APLOMB_FLAG_VALID) != 0;
}
