/* Counts the instructions of one filter's update in QEMU (-icount shift=0), over a minute of rest,
 * turns and accelerations at 1 kHz. SUBJECT: 0 no filter, 1 aplomb, 2 with a compass, 3 Fusion.
 *
 * The motion is that of rigs/src/bin/cost.rs. Each filter delivers quaternion, rates and Euler
 * angles. Prints "mean, maximum, first, state, stack of the start, stack of an update": the mean in
 * tenths, the last three in bytes. */
#include <math.h>
#include <string.h>

#include "aplomb.h"
#if SUBJECT == 3
#include "Fusion.h"
#endif

#define SAMPLES 60000u
#define REST_SAMPLES 3000u
#define STEP_S 1.0e-3f
#define GRAVITY_M_S2 9.80665f
#define RADIANS_PER_DEGREE 0.017453293f

#define RCC_APB1ENR (*(volatile uint32_t *)0x40023840u)
#define TIM2_CR1 (*(volatile uint32_t *)0x40000000u)
#define TIM2_EGR (*(volatile uint32_t *)0x40000014u)
#define TIM2_CNT (*(volatile uint32_t *)0x40000024u)
#define TIM2_ARR (*(volatile uint32_t *)0x4000002Cu)

void print(const char *text);

/* The mathematics of the C library asks for both; -1 is IEEE, without errors. */
const signed char __fdlib_version = -1;
int *__errno(void)
{
    static int number;
    return &number;
}

/* Forward, left, up; the field is a reading along these axes. */
typedef struct {
    uint64_t t_us;
    float force_m_s2[3], rate_rad_s[3], force_g[3], rate_deg_s[3], field_ut[3];
    bool has_field;
} Input;

static float q[4] = {0};
static uint32_t noise_state;

static float noise(float amplitude)
{
    noise_state = noise_state * 1664525u + 1013904223u;
    return amplitude * (float)(noise_state >> 8) / (float)(1 << 23) - amplitude;
}

/* Turns the attitude by small angles. */
static void turn(const float angle[3])
{
    float a[4];
    memcpy(a, q, sizeof a);
    float x = angle[0] / 2, y = angle[1] / 2, z = angle[2] / 2, norm = 0;
    q[0] += -a[1] * x - a[2] * y - a[3] * z;
    q[1] += a[0] * x + a[2] * z - a[3] * y;
    q[2] += a[0] * y - a[1] * z + a[3] * x;
    q[3] += a[0] * z + a[1] * y - a[2] * x;
    for (int i = 0; i < 4; i++) {
        norm += q[i] * q[i];
    }
    for (int i = 0; i < 4; i++) {
        q[i] /= sqrtf(norm);
    }
}

/* Turns a vector from the earth's axes into the body's. */
static void to_body(const float earth[3], float body[3])
{
    float w = q[0], x = q[1], y = q[2], z = q[3];
    const float rows[3][3] = {
        {1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)},
        {2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)},
        {2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)},
    };
    for (int i = 0; i < 3; i++) {
        body[i] = rows[i][0] * earth[0] + rows[i][1] * earth[1] + rows[i][2] * earth[2];
    }
}

__attribute__((noinline)) static void next(uint32_t index, Input *input)
{
    static const float field_ut[3] = {20, 0, 45}, offset_deg_s[3] = {1.0f, -0.5f, 0.7f};
    float t = index < REST_SAMPLES ? 0.0f : (float)(index - REST_SAMPLES) * STEP_S;
    float share = index < REST_SAMPLES ? 0.0f : 1.0f;
    float rate[3] = {2 * sinf(1.1f * t), 1.5f * sinf(1.7f * t), sinf(0.6f * t)};
    float earth[3] = {3 * sinf(2.3f * t), 2 * sinf(3.1f * t), 2 * sinf(4.7f * t)};
    float angle[3], force[3], field[3];
    if (index == 0) {
        q[0] = 1;
        q[1] = q[2] = q[3] = 0;
        noise_state = 1;
    }
    for (int i = 0; i < 3; i++) {
        rate[i] *= share;
        earth[i] *= share;
        angle[i] = rate[i] * STEP_S;
    }
    turn(angle);
    earth[2] -= GRAVITY_M_S2;
    to_body(earth, force);
    to_body(field_ut, field);
    field[0] += 30;
    input->t_us = (uint64_t)index * 1000;
    input->has_field = index % 10 == 0;
    for (int i = 0; i < 3; i++) {
        float sign = i == 0 ? 1.0f : -1.0f;
        float measured = rate[i] + offset_deg_s[i] * RADIANS_PER_DEGREE + noise(0.003f);
        input->force_m_s2[i] = sign * (force[i] + noise(0.1f));
        input->rate_rad_s[i] = sign * measured;
        input->field_ut[i] = sign * field[i];
        input->force_g[i] = input->force_m_s2[i] / GRAVITY_M_S2;
        input->rate_deg_s[i] = input->rate_rad_s[i] / RADIANS_PER_DEGREE;
    }
}

#if SUBJECT == 0
static char state;

static void start(void)
{
}

__attribute__((noinline)) static void update(const Input *input)
{
    state = (char)input->t_us;
}
#elif SUBJECT == 3
static struct {
    FusionAhrs filter;
} state;
static volatile FusionQuaternion quaternion;
static volatile FusionEuler euler;

static void start(void)
{
    FusionAhrsSettings settings = fusionAhrsDefaultSettings;
    settings.sampleRate = 1.0f / STEP_S;
    settings.gain = 0.2f;
    FusionAhrsInitialise(&state.filter);
    FusionAhrsSetSettings(&state.filter, &settings);
}

__attribute__((noinline)) static void update(const Input *input)
{
    FusionVector rate, force;
    memcpy(rate.array, input->rate_deg_s, sizeof rate.array);
    memcpy(force.array, input->force_g, sizeof force.array);
    FusionAhrsUpdateNoMagnetometer(&state.filter, rate, force);
    FusionQuaternion found = FusionAhrsGetQuaternion(&state.filter);
    quaternion = found;
    euler = FusionQuaternionToEuler(found);
}
#else
#if SUBJECT == 1
static AplombPipeline state;
#define INIT aplomb_init
#define UPDATE aplomb_update_sample
#else
static AplombCompassPipeline state;
#define INIT aplomb_compass_init
#define UPDATE aplomb_compass_update_sample
#endif
static AplombSnapshot snapshot;

static void start(void)
{
    AplombSettings settings = aplomb_default_settings();
    settings.accelerometer_knowledge = APLOMB_ACCELEROMETER_KNOWLEDGE_CALIBRATED;
    settings.sensor_delay_us = 0;
    INIT(&state, &settings);
}

__attribute__((noinline)) static void update(const Input *input)
{
    AplombSample sample;
    memset(&sample, 0, sizeof sample);
    sample.t_us = input->t_us;
    memcpy(sample.specific_force_m_s2, input->force_m_s2, sizeof sample.specific_force_m_s2);
    memcpy(sample.angular_rate_rad_s, input->rate_rad_s, sizeof sample.angular_rate_rad_s);
    UPDATE(&state, &sample, &snapshot);
#if SUBJECT == 2
    if (input->has_field) {
        AplombField field;
        memcpy(field.field_ut, input->field_ut, sizeof field.field_ut);
        field.age_us = 5000;
        aplomb_compass_update_field(&state, &field);
    }
#endif
}
#endif

static void print_number(uint64_t number)
{
    char text[24];
    char *digit = text + sizeof text - 1;
    *digit = 0;
    do {
        *--digit = (char)('0' + number % 10);
        number /= 10;
    } while (number > 0);
    print(digit);
}

#define PAINT 0x5AFEC0DEu
extern uint32_t bss_end[];

/* Fills the unused stack. */
__attribute__((noinline)) static void paint(void)
{
    uint32_t here;
    for (volatile uint32_t *word = bss_end; word < &here - 32; word++) {
        *word = PAINT;
    }
}

/* Returns the bytes of stack below the caller that were used since then. */
__attribute__((noinline)) static uint32_t used(void)
{
    uint32_t here;
    const volatile uint32_t *word = bss_end;
    while (word < &here && *word == PAINT) {
        word++;
    }
    return (uint32_t)((uintptr_t)&here - (uintptr_t)word);
}

static void print_next(uint64_t number)
{
    print(",");
    print_number(number);
}

int main(void)
{
    static Input input;
    uint64_t total = 0;
    uint32_t first = 0, maximum = 0, overhead, stack_of_start;
    RCC_APB1ENR |= 1;
    TIM2_ARR = 0xFFFFFFFFu;
    TIM2_EGR = 1;
    TIM2_CR1 = 1;
    overhead = TIM2_CNT;
    overhead = TIM2_CNT - overhead;
    paint();
    start();
    stack_of_start = used();
    paint();
    for (uint32_t index = 0; index < SAMPLES; index++) {
        next(index, &input);
        uint32_t before = TIM2_CNT;
        update(&input);
        uint32_t instructions = TIM2_CNT - before - overhead;
        total += instructions;
        if (index == 0) {
            first = instructions;
        } else if (instructions > maximum) {
            maximum = instructions;
        }
    }
    print_number((10 * total + SAMPLES / 2) / SAMPLES);
    print_next(maximum);
    print_next(first);
    print_next(sizeof state);
    print_next(stack_of_start);
    print_next(used());
    print("\n");
    return 0;
}
