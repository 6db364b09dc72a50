/* The model, whatever the version of FMI: values, start, samples, what is shown. Statuses are those of FMI 2 and 3. */

enum { OK = 0, WARNING = 1, DISCARD = 2, ERROR = 3 };
enum { INSTANTIATED = 1, INITIALIZATION = 2, EVENT = 4, CONTINUOUS = 8, STEP = 16, TERMINATED = 32 };

#define RUNNING (EVENT | CONTINUOUS | STEP)
#define READABLE (INSTANTIATED | INITIALIZATION | RUNNING | TERMINATED)
/* Share of a sample by which a communication point may miss it; a master's sum of steps carries rounding. */
#define TIME_SLACK 0.01
#define SAMPLES_MAX 1e9

/* All that changes during a run. */
typedef struct {
  double values[N_VALUES];
  double inputs[N_INPUTS];         /* as they were set */
  double held[N_INPUTS];           /* at the sample that is shown */
  double x[N_STATES];
  double c[N_CONSTANTS];
  double calculated[N_CALCULATED];
  double outputs[N_OUTPUTS];
  double derivatives[N_STATES];
  double start_time;
  double time;
  double samples;                  /* a whole number */
  int mode;
  int begun;                       /* initialisation has ended */
  int between;                     /* the communication point lies inside a sample, whose inputs are taken */
  int setup_due, outputs_due, derivatives_due;
} Core;

typedef struct {
  unsigned long long key;
  Core core;
} Saved;

typedef struct {
  Core core;
  double work[N_WORK];
  double next[N_STATES];
  double c[N_CONSTANTS];
  double guards[N_GUARDS];
  Logger logger;
  int logging;
  char name[128];
} Instance;

static void emit(Instance *m, int status, const char *category, const char *text);

static int report(Instance *m, int status, const char *format, ...) {
  char text[512];
  va_list arguments;
  if (status < ERROR && !m->logging) {
    return status;
  }
  va_start(arguments, format);
  (void)vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  emit(m, status, status < ERROR ? "logStatusWarning" : "logStatusError", text);
  return status;
}

static int permitted(Instance *m, int modes, const char *call) {
  if (m == NULL) {
    return 0;
  }
  if ((m->core.mode & modes) == 0) {
    (void)report(m, ERROR, "%s: must not be called now", call);
    return 0;
  }
  return 1;
}

static int enter(Instance *m, int from, int to, const char *call) {
  if (!permitted(m, from, call)) {
    return ERROR;
  }
  m->core.mode = to;
  return OK;
}

static int all_finite(const double *values, size_t n) {
  size_t k;
  for (k = 0; k < n; k++) {
    if (!isfinite(values[k])) {
      return 0;
    }
  }
  return 1;
}

static void restart(Core *core) {
  memset(core, 0, sizeof *core);
  memcpy(core->values, parameter_start, sizeof(double) * N_PARAMETERS);
  memcpy(core->inputs, input_start, sizeof core->inputs);
  memcpy(core->held, input_start, sizeof core->held);
#if N_PLACEMENT_INPUTS > 0
  memcpy(core->values + N_PARAMETERS, input_start, sizeof(double) * N_PLACEMENT_INPUTS);
#endif
  core->mode = INSTANTIATED;
  core->setup_due = core->outputs_due = core->derivatives_due = 1;
}

/* Constants, and before the run the start, from the parameters. */
static int prepare(Instance *m) {
  Core *core = &m->core;
  size_t k;
  if (!core->setup_due) {
    return OK;
  }
  compute_setup(core->values, m->c, m->next, core->calculated, m->guards, m->work);
  for (k = 0; k < N_GUARDS; k++) {
    if (!(m->guards[k] >= guard_low[k] && m->guards[k] <= guard_high[k])) {
      return report(m, ERROR, "%s (%.6g; allowed from %.6g to %.6g)", guard_text[k], m->guards[k], guard_low[k],
                    guard_high[k]);
    }
  }
  if (!all_finite(m->c, N_CONSTANTS) || !all_finite(m->next, N_STATES)
      || !all_finite(core->calculated, N_CALCULATED)) {
    return report(m, ERROR, "the parameters give numbers that are not finite");
  }
  memcpy(core->c, m->c, sizeof core->c);
  if (!core->begun) {
    memcpy(core->x, m->next, sizeof core->x);
  }
  core->setup_due = 0;
  core->outputs_due = core->derivatives_due = 1;
  return OK;
}

static int show(Instance *m) {
  Core *core = &m->core;
  size_t k;
  int status = prepare(m);
  if (status != OK || !core->outputs_due) {
    return status;
  }
  compute_outputs(core->x, core->held, core->c, core->outputs, m->work);
  for (k = 0; k < N_OUTPUTS; k++) {
    if (!isfinite(core->outputs[k])) {
      return report(m, ERROR, "%s is not finite at %.9g s: the arm may be in a singular posture", output_name[k],
                    core->time);
    }
  }
  core->outputs_due = 0;
  return OK;
}

#if MODEL_EXCHANGE
static int differentiate(Instance *m) {
  Core *core = &m->core;
  int status = prepare(m);
  if (status != OK || !core->derivatives_due) {
    return status;
  }
  compute_rates(core->x, core->held, core->c, core->derivatives, m->work);
  if (!all_finite(core->derivatives, N_STATES)) {
    return report(m, ERROR, "a derivative is not finite at %.9g s: the arm may be in a singular posture", core->time);
  }
  core->derivatives_due = 0;
  return OK;
}
#endif

/* Values of real variables. Value references count the time, parameters, inputs, outputs, calculated parameters, and
   for model exchange states and derivatives, in this order. */
static int get_reals(Instance *m, const unsigned int *reference, size_t n, double *value) {
  const Core *core = &m->core;
  size_t k;
  if (n > 0 && (reference == NULL || value == NULL)) {
    return report(m, ERROR, "get: a pointer is NULL");
  }
  for (k = 0; k < n; k++) {
    const double *from = NULL;
    unsigned int r = reference[k];
    int status = OK;
    if (r >= FIRST_DERIVATIVE + N_DERIVATIVES) {
      return report(m, ERROR, "get: value reference %u is not known", r);
    }
    if (r == 0) {
      from = &core->time;
    } else if (r < FIRST_INPUT) {
      from = core->values + (r - 1);
    } else if (r < FIRST_OUTPUT) {
      from = core->inputs + (r - FIRST_INPUT);
    } else if (r < FIRST_CALCULATED) {
      status = show(m);
      from = core->outputs + (r - FIRST_OUTPUT);
    } else if (r < FIRST_STATE) {
      status = prepare(m);
      from = core->calculated + (r - FIRST_CALCULATED);
    }
#if MODEL_EXCHANGE
    else if (r < FIRST_DERIVATIVE) {
      status = prepare(m);
      from = core->x + (r - FIRST_STATE);
    } else {
      status = differentiate(m);
      from = core->derivatives + (r - FIRST_DERIVATIVE);
    }
#endif
    if (status != OK) {
      return status;
    }
    value[k] = *from;
  }
  return OK;
}

static int settable(Instance *m, unsigned int r, double value) {
  const char *name;
  double low, high;
  if (r >= 1 && r < FIRST_INPUT) {
    unsigned int k = r - 1;
    int modes = INSTANTIATED | INITIALIZATION | (parameter_tunable[k] ? EVENT | STEP : 0);
    name = parameter_name[k], low = parameter_low[k], high = parameter_high[k];
    if ((m->core.mode & modes) == 0) {
      return report(m, ERROR, "set: parameter %s must not change now", name);
    }
  } else if (r >= FIRST_INPUT && r < FIRST_OUTPUT) {
    unsigned int k = r - FIRST_INPUT;
    name = input_name[k], low = input_low[k], high = input_high[k];
  } else {
    return report(m, ERROR, "set: value reference %u is no parameter and no input", r);
  }
  if (!isfinite(value)) {
    return report(m, ERROR, "set: %s must be finite", name);
  }
  if (value < low || value > high) {
    return report(m, ERROR, "set: %s = %.9g must lie between %.9g and %.9g", name, value, low, high);
  }
  return OK;
}

/* Sets all values or none. */
static int set_reals(Instance *m, const unsigned int *reference, size_t n, const double *value) {
  Core *core = &m->core;
  size_t k;
  int changed = 0;
  if (n > 0 && (reference == NULL || value == NULL)) {
    return report(m, ERROR, "set: a pointer is NULL");
  }
  for (k = 0; k < n; k++) {
    int status = settable(m, reference[k], value[k]);
    if (status != OK) {
      return status;
    }
  }
  for (k = 0; k < n; k++) {
    if (reference[k] < FIRST_INPUT) {
      core->values[reference[k] - 1] = value[k];
      core->setup_due = 1;
    } else {
      core->inputs[reference[k] - FIRST_INPUT] = value[k];
      changed = 1;
    }
  }
  if (changed) {
#if N_PLACEMENT_INPUTS > 0
    if (!core->begun) { /* the placement comes first among the inputs */
      memcpy(core->values + N_PARAMETERS, core->inputs, sizeof(double) * N_PLACEMENT_INPUTS);
      core->setup_due = 1;
    }
#endif
    if (!core->between) {
      memcpy(core->held, core->inputs, sizeof core->held);
    }
  }
  core->outputs_due = core->derivatives_due = 1;
  return OK;
}

static int set_start(Instance *m, double start) {
  if (!isfinite(start)) {
    return report(m, ERROR, "the start time must be finite");
  }
  m->core.start_time = m->core.time = start;
  return OK;
}

static int begin(Instance *m) {
  int status = show(m);
  if (status != OK) {
    return status;
  }
  m->core.begun = 1;
  m->core.mode = MODEL_EXCHANGE ? EVENT : STEP;
  return OK;
}

#if !MODEL_EXCHANGE
/* Whole samples that end within the step; between samples the last one is shown, and its inputs stay those that were
   set when it began. Inputs move on at their rates from the start of the step. */
static int do_step(Instance *m, double from, double size) {
  Core *core = &m->core;
  double reach, until;
  int status = prepare(m);
  size_t k;
  if (status != OK) {
    return status;
  }
  if (!isfinite(from) || !isfinite(size) || !(size > 0.0)) {
    return report(m, ERROR, "step: needs a finite time and a size greater than 0, not %.9g and %.9g", from, size);
  }
  if (fabs(from - core->time) > TIME_SLACK * SAMPLE_PERIOD) {
    return report(m, ERROR, "step: begins at %.12g s, but the model stands at %.12g s", from, core->time);
  }
  reach = (from + size - core->start_time) / SAMPLE_PERIOD;
  until = floor(reach + TIME_SLACK);
  if (until - core->samples > SAMPLES_MAX) {
    return report(m, ERROR, "step: more than %.0e samples of %.9g s", SAMPLES_MAX, SAMPLE_PERIOD);
  }
  if (!core->between) {
    memcpy(core->held, core->inputs, sizeof core->held);
  }
  core->outputs_due = 1;
  while (core->samples < until) {
    double elapsed, residual = 0.0;
    compute_step(core->x, core->held, core->c, m->next, &residual, m->work);
    if (!all_finite(m->next, N_STATES)) {
      core->time = core->start_time + core->samples * SAMPLE_PERIOD;
      return report(m, ERROR, "step: the loop leaves the finite numbers at %.9g s", core->time);
    }
    if (!(residual <= RESIDUAL_MAX)) {
      core->time = core->start_time + core->samples * SAMPLE_PERIOD;
      return report(m, ERROR, "step: the implicit integrator did not converge at %.9g s", core->time);
    }
    memcpy(core->x, m->next, sizeof core->x);
    core->samples += 1.0;
    elapsed = core->start_time + core->samples * SAMPLE_PERIOD - from;
    for (k = 0; k < N_INPUTS; k++) {
      core->held[k] = core->inputs[k] + (input_rate[k] < 0 ? 0.0 : elapsed * core->inputs[input_rate[k]]);
    }
  }
  core->between = reach - core->samples > TIME_SLACK;
  core->time = from + size;
  return OK;
}
#endif

#if MODEL_EXCHANGE
static int set_time(Instance *m, double time) {
  if (!isfinite(time)) {
    return report(m, ERROR, "the time must be finite");
  }
  m->core.time = time;
  return OK;
}

static int set_states(Instance *m, const double *x, size_t n) {
  if (n != N_STATES || x == NULL) {
    return report(m, ERROR, "set states: needs %d numbers, not %lu", (int)N_STATES, (unsigned long)n);
  }
  if (!all_finite(x, n)) {
    return report(m, ERROR, "set states: every state must be finite");
  }
  memcpy(m->core.x, x, sizeof m->core.x);
  m->core.outputs_due = m->core.derivatives_due = 1;
  return OK;
}

/* Of every state a number, where all is well so far. */
static int give(Instance *m, int status, const char *what, const double *from, double *to, size_t n) {
  if (status == OK && (n != N_STATES || to == NULL)) {
    return report(m, ERROR, "get %s: there are %d, not %lu", what, (int)N_STATES, (unsigned long)n);
  }
  if (status == OK) {
    memcpy(to, from, sizeof(double) * N_STATES);
  }
  return status;
}
#endif

static int restore(Instance *m, const Saved *saved) {
  if (saved == NULL || saved->key != MODEL_KEY) {
    return report(m, ERROR, "set state: it is no state of this model");
  }
  m->core = saved->core;
  return OK;
}

static int serialize(Instance *m, const Saved *saved, unsigned char *bytes, size_t size) {
  if (saved == NULL || bytes == NULL || size < sizeof *saved) {
    return report(m, ERROR, "serialize: needs a state and room for %lu bytes", (unsigned long)sizeof *saved);
  }
  memcpy(bytes, saved, sizeof *saved);
  return OK;
}

static int deserialize(Instance *m, const unsigned char *bytes, size_t size, Saved *saved) {
  if (bytes == NULL || size != sizeof *saved) {
    return report(m, ERROR, "deserialize: needs %lu bytes, not %lu", (unsigned long)sizeof *saved, (unsigned long)size);
  }
  memcpy(saved, bytes, sizeof *saved);
  if (saved->key != MODEL_KEY) {
    return report(m, ERROR, "deserialize: it is no state of this model");
  }
  return OK;
}

/* Whether the name and the token are those of this model. */
static const char *identity_fault(const char *name, const char *token) {
  if (name == NULL || name[0] == '\0') {
    return "instantiate: the instance needs a name";
  }
  if (token == NULL || strcmp(token, MODEL_TOKEN) != 0) {
    return "instantiate: the token is not that of this model; modelDescription.xml and the library do not match";
  }
  return NULL;
}

static void christen(Instance *m, const char *name) {
  strncpy(m->name, name, sizeof m->name - 1);
  restart(&m->core);
}
