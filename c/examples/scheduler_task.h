/* Attitude as a task: see scheduler_task.c. */
#ifndef SCHEDULER_TASK_H
#define SCHEDULER_TASK_H

#include "aplomb.h"

bool attitude_init(uint16_t samples_per_s);
bool attitude_task(uint64_t now_us, const float force[3], const float rate[3], AplombSnapshot *out);

#endif
