{% set fmi, component, state, reals = "fmi2", "fmi2Component", "FMUstate", "Real" %}
{% set deserialize, get_derivatives = "DeSerialize", "GetDerivatives" %}
{% set allocate, release = "m->logger->allocateMemory", "m->logger->freeMemory" %}
{% from "export/fmu/templates/refusals.c" import refuse_null, refuse_unless with context %}
/* FMI 2.0: its types, and its functions around the model. */

#ifndef FMI2_FUNCTION_PREFIX
#define FMI2_FUNCTION_PREFIX
#endif
#define PASTED(a, b) a##b
#define NAMED(a, b) PASTED(a, b)
#define F(name) NAMED(FMI2_FUNCTION_PREFIX, fmi2##name)

typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef char fmi2Char;
typedef const fmi2Char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;

typedef struct {
  void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
  void *(*allocateMemory)(size_t, size_t);
  void (*freeMemory)(void *);
  void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
  fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

typedef struct {
  fmi2Boolean newDiscreteStatesNeeded;
  fmi2Boolean terminateSimulation;
  fmi2Boolean nominalsOfContinuousStatesChanged;
  fmi2Boolean valuesOfContinuousStatesChanged;
  fmi2Boolean nextEventTimeDefined;
  fmi2Real nextEventTime;
} fmi2EventInfo;

typedef const fmi2CallbackFunctions *Logger;

{% include "export/fmu/templates/common.c" %}
static void emit(Instance *m, int status, const char *category, const char *text) {
  if (m->logger->logger != NULL) {
    m->logger->logger(m->logger->componentEnvironment, m->name, (fmi2Status)status, category, "%s", text);
  }
}

{% include "export/fmu/templates/interface.c" %}

EXPORT const char *F(GetTypesPlatform)(void) { return "default"; }

EXPORT const char *F(GetVersion)(void) { return "2.0"; }

EXPORT fmi2Component F(Instantiate)(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                    const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
  Instance *m;
  const char *fault;
  (void)resources, (void)visible;
  if (functions == NULL || functions->allocateMemory == NULL || functions->freeMemory == NULL) {
    return NULL;
  }
  fault = identity_fault(name, guid);
  if (fault == NULL && type != (MODEL_EXCHANGE ? fmi2ModelExchange : fmi2CoSimulation)) {
    fault = MODEL_EXCHANGE ? "instantiate: the model is for model exchange" : "instantiate: the model is for co-simulation";
  }
  if (fault != NULL) {
    if (functions->logger != NULL) {
      functions->logger(functions->componentEnvironment, name == NULL ? "" : name, fmi2Error, "logStatusError", "%s", fault);
    }
    return NULL;
  }
  m = (Instance *)functions->allocateMemory(1, sizeof(Instance));
  if (m == NULL) {
    return NULL;
  }
  memset(m, 0, sizeof *m);
  m->logger = functions;
  m->logging = logging;
  christen(m, name);
  return m;
}

EXPORT void F(FreeInstance)(fmi2Component c) {
  Instance *m = (Instance *)c;
  if (m != NULL) {
    m->logger->freeMemory(m);
  }
}

EXPORT fmi2Status F(SetupExperiment)(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                                     fmi2Boolean stop_defined, fmi2Real stop) {
  Instance *m = (Instance *)c;
  (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
  return permitted(m, INSTANTIATED, "fmi2SetupExperiment") ? (fmi2Status)set_start(m, start) : fmi2Error;
}

EXPORT fmi2Status F(EnterInitializationMode)(fmi2Component c) {
  return (fmi2Status)enter((Instance *)c, INSTANTIATED, INITIALIZATION, "fmi2EnterInitializationMode");
}

EXPORT fmi2Status F(GetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
  Instance *m = (Instance *)c;
  return permitted(m, READABLE, "fmi2GetReal") ? (fmi2Status)get_reals(m, vr, n, value) : fmi2Error;
}

EXPORT fmi2Status F(SetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
  Instance *m = (Instance *)c;
  return permitted(m, READABLE & ~TERMINATED, "fmi2SetReal") ? (fmi2Status)set_reals(m, vr, n, value) : fmi2Error;
}

#define NO_VARIABLES(type)                                                                                     \
  EXPORT fmi2Status F(Get##type)(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2##type value[]) { \
    (void)vr, (void)value;                                                                                     \
    return no_variables(c, n, "fmi2Get" #type);                                                                \
  }                                                                                                            \
  EXPORT fmi2Status F(Set##type)(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2##type value[]) { \
    (void)vr, (void)value;                                                                                     \
    return no_variables(c, n, "fmi2Set" #type);                                                                \
  }

NO_VARIABLES(Integer)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

EXPORT fmi2Status F(GetDirectionalDerivative)(fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,
                                              const fmi2ValueReference known[], size_t n_known, const fmi2Real seed[],
                                              fmi2Real sensitivity[]) {
  (void)unknown, (void)n_unknown, (void)known, (void)n_known, (void)seed, (void)sensitivity;
  return unsupported(c, "fmi2GetDirectionalDerivative");
}

#if MODEL_EXCHANGE
EXPORT fmi2Status F(NewDiscreteStates)(fmi2Component c, fmi2EventInfo *info) {
  Instance *m = (Instance *)c;
  {{ refuse_unless("NewDiscreteStates", "EVENT") }}
  {{ refuse_null("NewDiscreteStates", "info") }}
  memset(info, 0, sizeof *info);
  return fmi2OK;
}
#else
EXPORT fmi2Status F(SetRealInputDerivatives)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                             const fmi2Integer order[], const fmi2Real value[]) {
  (void)vr, (void)n, (void)order, (void)value;
  return unsupported(c, "fmi2SetRealInputDerivatives");
}

EXPORT fmi2Status F(GetRealOutputDerivatives)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                              const fmi2Integer order[], fmi2Real value[]) {
  (void)vr, (void)n, (void)order, (void)value;
  return unsupported(c, "fmi2GetRealOutputDerivatives");
}

EXPORT fmi2Status F(DoStep)(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean final) {
  Instance *m = (Instance *)c;
  (void)final;
  return permitted(m, STEP, "fmi2DoStep") ? (fmi2Status)do_step(m, time, size) : fmi2Error;
}

EXPORT fmi2Status F(CancelStep)(fmi2Component c) {
  return unsupported(c, "fmi2CancelStep");
}

#define NO_STATUS(name, type)                                                          \
  EXPORT fmi2Status F(name)(fmi2Component c, const fmi2StatusKind kind, type *value) { \
    (void)kind, (void)value;                                                           \
    return unsupported(c, "fmi2" #name);                                               \
  }
#define STATUS(name, type, known, now)                                                 \
  EXPORT fmi2Status F(name)(fmi2Component c, const fmi2StatusKind kind, type *value) { \
    Instance *m = (Instance *)c;                                                       \
    if (kind != known || value == NULL) {                                              \
      return unsupported(c, "fmi2" #name);                                             \
    }                                                                                  \
    if (!permitted(m, STEP | TERMINATED, "fmi2" #name)) {                              \
      return fmi2Error;                                                                \
    }                                                                                  \
    *value = now;                                                                      \
    return fmi2OK;                                                                     \
  }

NO_STATUS(GetStatus, fmi2Status)
STATUS(GetRealStatus, fmi2Real, fmi2LastSuccessfulTime, m->core.time)
NO_STATUS(GetIntegerStatus, fmi2Integer)
STATUS(GetBooleanStatus, fmi2Boolean, fmi2Terminated, 0)
NO_STATUS(GetStringStatus, fmi2String)
#endif
