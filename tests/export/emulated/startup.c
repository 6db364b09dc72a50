/* Start of a program on an emulated Cortex-M board of Arm's MPS2 family, with semihosting; a clock and a stack gauge. */
#include <stdint.h>

#define SYSTICK_CONTROL (*(volatile uint32_t *)0xE000E010u)
#define SYSTICK_RELOAD (*(volatile uint32_t *)0xE000E014u)
#define SYSTICK_VALUE (*(volatile uint32_t *)0xE000E018u)
#define COPROCESSORS (*(volatile uint32_t *)0xE000ED88u)

enum { PAINTED_WORDS = 32768, CALIBRATION_LOOPS = 2000000 };
static const uint32_t paint = 0xC5C5C5C5u;

extern uint32_t stack_top;
extern void _start(void);
void reset(void);
void stop(void);
uint32_t target_ticks(void);
uint32_t target_calibrate(void);
void target_paint_stack(void);
uint32_t target_stack_used(void);

__attribute__((section(".vectors"), used)) static void (*const vectors[16])(void) = {
  (void (*)(void))&stack_top, reset, stop, stop, stop, stop, stop, 0, 0, 0, 0, stop, stop, 0, stop, stop,
};

void reset(void)
{
  COPROCESSORS |= 0xFu << 20; /* the floating-point unit */
  SYSTICK_RELOAD = 0xFFFFFFu;
  SYSTICK_VALUE = 0u;
  SYSTICK_CONTROL = 5u; /* on, the processor's clock, no interrupt */
  _start();
}

/* A fault ends the program with an error: SYS_EXIT with a reason that is none of success. */
void stop(void)
{
  register uint32_t operation __asm("r0") = 0x18u;
  register uint32_t reason __asm("r1") = 0x20023u;
  __asm volatile("bkpt 0xab" : : "r"(operation), "r"(reason) : "memory");
  for (;;) {
  }
}

/* Counts up, 24 bits. */
uint32_t target_ticks(void)
{
  return 0xFFFFFFu - SYSTICK_VALUE;
}

/* Ticks of four million instructions. */
uint32_t target_calibrate(void)
{
  uint32_t loops = CALIBRATION_LOOPS, start = target_ticks();
  __asm volatile("1: subs %0, %0, #1\n bne 1b" : "+r"(loops) : : "cc");
  return (target_ticks() - start) & 0xFFFFFFu;
}

static uint32_t *painted_from;

static uint32_t *stack_pointer(void)
{
  uint32_t *pointer;
  __asm volatile("mov %0, sp" : "=r"(pointer));
  return pointer;
}

void target_paint_stack(void)
{
  volatile uint32_t *cell;
  uint32_t k;
  painted_from = stack_pointer() - 8;
  cell = painted_from;
  for (k = 0; k < PAINTED_WORDS; ++k) {
    *--cell = paint;
  }
}

uint32_t target_stack_used(void)
{
  volatile uint32_t *cell = painted_from - PAINTED_WORDS;
  while ((cell < painted_from) && (*cell == paint)) {
    ++cell;
  }
  return (uint32_t)((uint32_t)painted_from - (uint32_t)cell);
}
