/* Start-up of a Cortex-M core in QEMU, and output by semihosting. */
#include <stdint.h>

int main(void);
extern uint32_t stack_top[], bss_start[], bss_end[];

/* Calls the debugger. */
static void call(int operation, const void *argument)
{
    register int number __asm__("r0") = operation;
    register const void *value __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xAB" : "+r"(number) : "r"(value) : "memory");
}

void print(const char *text)
{
    call(0x04, text);
}

void reset(void)
{
#if defined(__ARM_FP)
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20;
    __asm__ volatile("dsb\n isb");
#endif
    for (uint32_t *word = bss_start; word < bss_end; word++) {
        *word = 0;
    }
    main();
    call(0x18, (const void *)0x20026);
    for (;;) {
    }
}

static void fault(void)
{
    print("a fault\n");
    call(0x18, (const void *)0x20024);
    for (;;) {
    }
}

/* An entry of the vector table. */
union vector {
    uint32_t *stack;
    void (*handler)(void);
};

__attribute__((section(".vectors"), used)) static const union vector vectors[] = {
    {.stack = stack_top}, {.handler = reset}, {.handler = fault}, {.handler = fault},
};
