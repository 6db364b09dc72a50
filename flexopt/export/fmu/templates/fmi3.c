{% set fmi, component, state, reals = "fmi3", "fmi3Instance", "FMUState", "Float64" %}
{% set deserialize, get_derivatives = "Deserialize", "GetContinuousStateDerivatives" %}
{% set allocate, release = "calloc", "free" %}
{% from "export/fmu/templates/refusals.c" import refuse_null, refuse_unless with context %}
/* FMI 3.0: its types, and its functions around the model. */

#include <stdbool.h>
#include <stdint.h>

#ifndef FMI3_FUNCTION_PREFIX
#define FMI3_FUNCTION_PREFIX
#endif
#define PASTED(a, b) a##b
#define NAMED(a, b) PASTED(a, b)
#define F(name) NAMED(FMI3_FUNCTION_PREFIX, fmi3##name)

typedef void *fmi3Instance;
typedef void *fmi3InstanceEnvironment;
typedef void *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean;
typedef char fmi3Char;
typedef const fmi3Char *fmi3String;
typedef uint8_t fmi3Byte;
typedef const fmi3Byte *fmi3Binary;
typedef bool fmi3Clock;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef int fmi3DependencyKind;
typedef int fmi3IntervalQualifier;
typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String);
typedef void (*fmi3IntermediateUpdateCallback)(fmi3InstanceEnvironment, fmi3Float64, fmi3Boolean, fmi3Boolean,
                                               fmi3Boolean, fmi3Boolean, fmi3Boolean *, fmi3Float64 *);
typedef void (*fmi3ClockUpdateCallback)(fmi3InstanceEnvironment);
typedef void (*fmi3LockPreemptionCallback)(void);
typedef void (*fmi3UnlockPreemptionCallback)(void);

typedef struct {
  fmi3InstanceEnvironment environment;
  fmi3LogMessageCallback message;
} Logger;

{% include "export/fmu/templates/common.c" %}
static void emit(Instance *m, int status, const char *category, const char *text) {
  if (m->logger.message != NULL) {
    m->logger.message(m->logger.environment, (fmi3Status)status, category, text);
  }
}

{% include "export/fmu/templates/interface.c" %}

static fmi3Instance created(const char *name, const char *token, int logging, fmi3InstanceEnvironment environment,
                            fmi3LogMessageCallback message, const char *fault) {
  Instance *m;
  const char *identity = identity_fault(name, token);
  fault = identity == NULL ? fault : identity;
  if (fault != NULL) {
    if (message != NULL) {
      message(environment, fmi3Error, "logStatusError", fault);
    }
    return NULL;
  }
  m = (Instance *)calloc(1, sizeof(Instance));
  if (m == NULL) {
    return NULL;
  }
  m->logger.environment = environment;
  m->logger.message = message;
  m->logging = logging;
  christen(m, name);
  return m;
}

EXPORT const char *F(GetVersion)(void) { return "3.0"; }

EXPORT fmi3Instance F(InstantiateModelExchange)(fmi3String name, fmi3String token, fmi3String resources,
                                                fmi3Boolean visible, fmi3Boolean logging,
                                                fmi3InstanceEnvironment environment, fmi3LogMessageCallback message) {
  (void)resources, (void)visible;
  return created(name, token, logging, environment, message,
                 MODEL_EXCHANGE ? NULL : "instantiate: the model is for co-simulation");
}

EXPORT fmi3Instance F(InstantiateCoSimulation)(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode,
                                               fmi3Boolean early_return, const fmi3ValueReference intermediate[],
                                               size_t n_intermediate, fmi3InstanceEnvironment environment,
                                               fmi3LogMessageCallback message, fmi3IntermediateUpdateCallback update) {
  const char *fault = NULL;
  (void)resources, (void)visible, (void)early_return, (void)intermediate, (void)update;
  if (MODEL_EXCHANGE) {
    fault = "instantiate: the model is for model exchange";
  } else if (event_mode || n_intermediate > 0) {
    fault = "instantiate: the model has no event mode and no intermediate variables";
  }
  return created(name, token, logging, environment, message, fault);
}

EXPORT fmi3Instance F(InstantiateScheduledExecution)(fmi3String name, fmi3String token, fmi3String resources,
                                                     fmi3Boolean visible, fmi3Boolean logging,
                                                     fmi3InstanceEnvironment environment, fmi3LogMessageCallback message,
                                                     fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                                     fmi3UnlockPreemptionCallback unlock) {
  (void)resources, (void)visible, (void)update, (void)lock, (void)unlock;
  return created(name, token, logging, environment, message, "instantiate: the model is not for scheduled execution");
}

EXPORT void F(FreeInstance)(fmi3Instance instance) {
  free(instance);
}

EXPORT fmi3Status F(EnterInitializationMode)(fmi3Instance instance, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                             fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop) {
  Instance *m = (Instance *)instance;
  int status;
  (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
  {{ refuse_unless("EnterInitializationMode", "INSTANTIATED") }}
  status = set_start(m, start);
  m->core.mode = status == OK ? INITIALIZATION : m->core.mode;
  return (fmi3Status)status;
}

EXPORT fmi3Status F(GetFloat64)(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, fmi3Float64 values[],
                                size_t n_values) {
  Instance *m = (Instance *)instance;
  {{ refuse_unless("GetFloat64", "READABLE") }}
  return (fmi3Status)(n == n_values ? get_reals(m, vr, n, values) : report(m, ERROR, "fmi3GetFloat64: counts differ"));
}

EXPORT fmi3Status F(SetFloat64)(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                                const fmi3Float64 values[], size_t n_values) {
  Instance *m = (Instance *)instance;
  {{ refuse_unless("SetFloat64", "READABLE & ~TERMINATED") }}
  return (fmi3Status)(n == n_values ? set_reals(m, vr, n, values) : report(m, ERROR, "fmi3SetFloat64: counts differ"));
}

#define NO_VARIABLES(type)                                                                                       \
  EXPORT fmi3Status F(Get##type)(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,                 \
                                 fmi3##type values[], size_t n_values) {                                         \
    (void)vr, (void)values, (void)n_values;                                                                      \
    return no_variables(instance, n, "fmi3Get" #type);                                                           \
  }                                                                                                              \
  EXPORT fmi3Status F(Set##type)(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,                 \
                                 const fmi3##type values[], size_t n_values) {                                   \
    (void)vr, (void)values, (void)n_values;                                                                      \
    return no_variables(instance, n, "fmi3Set" #type);                                                           \
  }

NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(Int32)
NO_VARIABLES(UInt32)
NO_VARIABLES(Int64)
NO_VARIABLES(UInt64)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

EXPORT fmi3Status F(GetBinary)(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, size_t sizes[],
                               fmi3Binary values[], size_t n_values) {
  (void)vr, (void)sizes, (void)values, (void)n_values;
  return no_variables(instance, n, "fmi3GetBinary");
}

EXPORT fmi3Status F(SetBinary)(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, const size_t sizes[],
                               const fmi3Binary values[], size_t n_values) {
  (void)vr, (void)sizes, (void)values, (void)n_values;
  return no_variables(instance, n, "fmi3SetBinary");
}

EXPORT fmi3Status F(GetClock)(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, fmi3Clock values[]) {
  (void)vr, (void)values;
  return no_variables(instance, n, "fmi3GetClock");
}

EXPORT fmi3Status F(SetClock)(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, const fmi3Clock values[]) {
  (void)vr, (void)values;
  return no_variables(instance, n, "fmi3SetClock");
}

EXPORT fmi3Status F(GetNumberOfVariableDependencies)(fmi3Instance instance, fmi3ValueReference vr, size_t *n) {
  (void)vr, (void)n;
  return unsupported(instance, "fmi3GetNumberOfVariableDependencies");
}

EXPORT fmi3Status F(GetVariableDependencies)(fmi3Instance instance, fmi3ValueReference dependent, size_t elements[],
                                             fmi3ValueReference independents[], size_t independent_elements[],
                                             fmi3DependencyKind kinds[], size_t n) {
  (void)dependent, (void)elements, (void)independents, (void)independent_elements, (void)kinds, (void)n;
  return unsupported(instance, "fmi3GetVariableDependencies");
}

#define NO_DERIVATIVES(name)                                                                                      \
  EXPORT fmi3Status F(name)(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t n_unknowns,        \
                            const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[],         \
                            size_t n_seed, fmi3Float64 sensitivity[], size_t n_sensitivity) {                     \
    (void)unknowns, (void)n_unknowns, (void)knowns, (void)n_knowns, (void)seed, (void)n_seed, (void)sensitivity;  \
    (void)n_sensitivity;                                                                                          \
    return unsupported(instance, "fmi3" #name);                                                                   \
  }

NO_DERIVATIVES(GetDirectionalDerivative)
NO_DERIVATIVES(GetAdjointDerivative)

EXPORT fmi3Status F(EnterConfigurationMode)(fmi3Instance instance) {
  return unsupported(instance, "fmi3EnterConfigurationMode");
}

EXPORT fmi3Status F(ExitConfigurationMode)(fmi3Instance instance) {
  return unsupported(instance, "fmi3ExitConfigurationMode");
}

#define NO_CLOCKS(name, first, second)                                                                             \
  EXPORT fmi3Status F(name)(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, first, second) {       \
    (void)vr, (void)a, (void)b;                                                                                    \
    return no_variables(instance, n, "fmi3" #name);                                                                \
  }
#define NO_SHIFTS(name, first)                                                                                     \
  EXPORT fmi3Status F(name)(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, first) {               \
    (void)vr, (void)a;                                                                                             \
    return no_variables(instance, n, "fmi3" #name);                                                                \
  }

NO_CLOCKS(GetIntervalDecimal, fmi3Float64 a[], fmi3IntervalQualifier b[])
NO_SHIFTS(GetShiftDecimal, fmi3Float64 a[])
NO_CLOCKS(GetShiftFraction, fmi3UInt64 a[], fmi3UInt64 b[])
NO_SHIFTS(SetIntervalDecimal, const fmi3Float64 a[])
NO_CLOCKS(SetIntervalFraction, const fmi3UInt64 a[], const fmi3UInt64 b[])
NO_SHIFTS(SetShiftDecimal, const fmi3Float64 a[])
NO_CLOCKS(SetShiftFraction, const fmi3UInt64 a[], const fmi3UInt64 b[])

EXPORT fmi3Status F(GetIntervalFraction)(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                                         fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                         fmi3IntervalQualifier qualifiers[]) {
  (void)vr, (void)counters, (void)resolutions, (void)qualifiers;
  return no_variables(instance, n, "fmi3GetIntervalFraction");
}

EXPORT fmi3Status F(EvaluateDiscreteStates)(fmi3Instance instance) {
  Instance *m = (Instance *)instance;
  return permitted(m, INITIALIZATION | EVENT, "fmi3EvaluateDiscreteStates") ? fmi3OK : fmi3Error;
}

EXPORT fmi3Status F(UpdateDiscreteStates)(fmi3Instance instance, fmi3Boolean *again, fmi3Boolean *terminate,
                                          fmi3Boolean *nominals_changed, fmi3Boolean *states_changed,
                                          fmi3Boolean *next_defined, fmi3Float64 *next) {
  Instance *m = (Instance *)instance;
  {{ refuse_unless("UpdateDiscreteStates", "EVENT") }}
  {{ refuse_null("UpdateDiscreteStates", "again", "terminate", "nominals_changed", "states_changed", "next_defined", "next") }}
  *again = *terminate = *nominals_changed = *states_changed = *next_defined = false;
  *next = 0.0;
  return fmi3OK;
}

EXPORT fmi3Status F(EnterStepMode)(fmi3Instance instance) {
  return unsupported(instance, "fmi3EnterStepMode");
}

#if !MODEL_EXCHANGE
EXPORT fmi3Status F(SetTime)(fmi3Instance instance, fmi3Float64 time) {
  (void)time;
  return unsupported(instance, "fmi3SetTime");
}

EXPORT fmi3Status F(SetContinuousStates)(fmi3Instance instance, const fmi3Float64 x[], size_t n) {
  (void)x, (void)n;
  return unsupported(instance, "fmi3SetContinuousStates");
}

#define NO_STATES(name)                                                              \
  EXPORT fmi3Status F(name)(fmi3Instance instance, fmi3Float64 values[], size_t n) { \
    (void)values, (void)n;                                                           \
    return unsupported(instance, "fmi3" #name);                                      \
  }

NO_STATES(GetContinuousStates)
NO_STATES(GetContinuousStateDerivatives)
NO_STATES(GetNominalsOfContinuousStates)
#endif

static fmi3Status counted(fmi3Instance instance, size_t *n, size_t count, const char *call) {
  Instance *m = (Instance *)instance;
  if (!permitted(m, READABLE, call)) {
    return fmi3Error;
  }
  if (n == NULL) {
    return (fmi3Status)report(m, ERROR, "%s: a pointer is NULL", call);
  }
  *n = count;
  return fmi3OK;
}

EXPORT fmi3Status F(GetNumberOfEventIndicators)(fmi3Instance instance, size_t *n) {
  return counted(instance, n, 0, "fmi3GetNumberOfEventIndicators");
}

EXPORT fmi3Status F(GetNumberOfContinuousStates)(fmi3Instance instance, size_t *n) {
  return counted(instance, n, MODEL_EXCHANGE ? N_STATES : 0, "fmi3GetNumberOfContinuousStates");
}

EXPORT fmi3Status F(GetOutputDerivatives)(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                                          const fmi3Int32 orders[], fmi3Float64 values[], size_t n_values) {
  (void)vr, (void)n, (void)orders, (void)values, (void)n_values;
  return unsupported(instance, "fmi3GetOutputDerivatives");
}

EXPORT fmi3Status F(DoStep)(fmi3Instance instance, fmi3Float64 time, fmi3Float64 size, fmi3Boolean final,
                            fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last) {
#if MODEL_EXCHANGE
  (void)time, (void)size, (void)final, (void)event, (void)terminate, (void)early, (void)last;
  return unsupported(instance, "fmi3DoStep");
#else
  Instance *m = (Instance *)instance;
  int status;
  (void)final;
  {{ refuse_unless("DoStep", "STEP") }}
  {{ refuse_null("DoStep", "event", "terminate", "early", "last") }}
  status = do_step(m, time, size);
  *event = *terminate = *early = false;
  *last = m->core.time;
  return (fmi3Status)status;
#endif
}

EXPORT fmi3Status F(ActivateModelPartition)(fmi3Instance instance, fmi3ValueReference clock, fmi3Float64 time) {
  (void)clock, (void)time;
  return unsupported(instance, "fmi3ActivateModelPartition");
}
