/* Attitudes from a table of samples in SI units, with or without a compass.
 *
 *   samples DIVIDER DELAY_US [COMPASS_KNOWLEDGE DECLINATION_RAD] < table
 *
 * A line is t_us, force, rates, two flags of saturation, and with a new reading of the compass the
 * field and its age. Prints t_us, quaternion, flags, heading, its sigma and the offset of yaw. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

#include "aplomb.h"

/* Reads this many numbers from the text. Returns how many there were. */
static int read_numbers(char **text, float *values, int count)
{
    for (int i = 0; i < count; i++) {
        char *end;
        values[i] = (float)strtod(*text, &end);
        if (end == *text) {
            return i;
        }
        *text = end;
    }
    return count;
}

/* Reads a line. Returns true if it has a reading of the compass. */
static bool read_line(char *text, AplombSample *sample, AplombField *field)
{
    float saturated[2], field_and_age[4];
    sample->t_us = strtoull(text, &text, 10);
    read_numbers(&text, sample->specific_force_m_s2, 3);
    read_numbers(&text, sample->angular_rate_rad_s, 3);
    if (read_numbers(&text, saturated, 2) != 2) {
        exit(2);
    }
    sample->is_force_saturated = saturated[0] != 0.0f;
    sample->is_rate_saturated = saturated[1] != 0.0f;
    if (read_numbers(&text, field_and_age, 4) != 4) {
        return false;
    }
    for (int axis = 0; axis < 3; axis++) {
        field->field_ut[axis] = field_and_age[axis];
    }
    field->age_us = (uint32_t)field_and_age[3];
    return true;
}

int main(int count, char **arguments)
{
    static AplombPipeline plain;
    static AplombCompassPipeline with_compass;
    AplombSettings settings = aplomb_default_settings();
    bool has_compass = count == 5;
    AplombStatus status;
    char line[512];
    if (count != 3 && count != 5) {
        return 2;
    }
    settings.sample_rate_divider = (uint8_t)strtoul(arguments[1], NULL, 10);
    settings.sensor_delay_us = (int32_t)strtol(arguments[2], NULL, 10);
    settings.accelerometer_knowledge = APLOMB_ACCELEROMETER_KNOWLEDGE_CALIBRATED;
    if (has_compass) {
        settings.compass_knowledge = (uint32_t)strtoul(arguments[3], NULL, 10);
        settings.declination_rad = (float)strtod(arguments[4], NULL);
    }
    status = has_compass ? aplomb_compass_init(&with_compass, &settings)
                         : aplomb_init(&plain, &settings);
    while (status == APLOMB_STATUS_OK && fgets(line, sizeof line, stdin) != NULL) {
        AplombSample sample = {0};
        AplombField field;
        AplombSnapshot found;
        bool has_field = read_line(line, &sample, &field);
        status = has_compass ? aplomb_compass_update_sample(&with_compass, &sample, &found)
                             : aplomb_update_sample(&plain, &sample, &found);
        if (has_compass && has_field) {
            aplomb_compass_update_field(&with_compass, &field);
        }
        printf("%" PRIu64 " %.9g %.9g %.9g %.9g %" PRIu32 " %.9g %.9g %.9g\n", found.t_us,
               (double)found.attitude[0], (double)found.attitude[1], (double)found.attitude[2],
               (double)found.attitude[3], found.flags, (double)found.heading_rad,
               (double)found.heading_sigma_rad, (double)found.yaw_offset_rad);
    }
    return status == APLOMB_STATUS_OK ? 0 : 1;
}
