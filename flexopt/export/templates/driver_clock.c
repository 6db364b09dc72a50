{# What a driver asks a microcontroller; on a workstation nothing. #}
#ifdef FLEXOPT_TARGET
uint32_t target_calibrate(void);
uint32_t target_ticks(void);
void target_paint_stack(void);
uint32_t target_stack_used(void);
#else
static uint32_t target_calibrate(void) { return 0; }
static uint32_t target_ticks(void) { return 0; }
static void target_paint_stack(void) {}
static uint32_t target_stack_used(void) { return 0; }
#endif
