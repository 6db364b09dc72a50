{# What both versions of FMI have in common but for names: modes, the state of an instance, and the states of the loop. #}
static {{ fmi }}Status no_variables({{ component }} instance, size_t n, const char *call) {
  Instance *m = (Instance *)instance;
  if (!permitted(m, READABLE, call)) {
    return {{ fmi }}Error;
  }
  return n == 0 ? {{ fmi }}OK : ({{ fmi }}Status)report(m, ERROR, "%s: the model has variables of type {{ reals }} alone", call);
}

static {{ fmi }}Status unsupported({{ component }} instance, const char *call) {
  Instance *m = (Instance *)instance;
  return permitted(m, READABLE, call) ? ({{ fmi }}Status)report(m, ERROR, "%s: is not offered", call) : {{ fmi }}Error;
}

/* Into a state that is there, or a new one. */
static {{ fmi }}Status keep(Instance *m, const Core *core, {{ fmi }}{{ state }} *state) {
  Saved *saved = (Saved *)(*state == NULL ? {{ allocate }}(1, sizeof(Saved)) : *state);
  if (saved == NULL) {
    return ({{ fmi }}Status)report(m, ERROR, "no memory");
  }
  saved->key = MODEL_KEY;
  saved->core = *core;
  *state = saved;
  return {{ fmi }}OK;
}

EXPORT {{ fmi }}Status F(SetDebugLogging)({{ component }} instance, {{ fmi }}Boolean on, size_t n, const {{ fmi }}String categories[]) {
  Instance *m = (Instance *)instance;
  (void)n, (void)categories;
  {{ refuse_unless("SetDebugLogging", "READABLE") }}
  m->logging = on;
  return {{ fmi }}OK;
}

EXPORT {{ fmi }}Status F(ExitInitializationMode)({{ component }} instance) {
  Instance *m = (Instance *)instance;
  return permitted(m, INITIALIZATION, "{{ fmi }}ExitInitializationMode") ? ({{ fmi }}Status)begin(m) : {{ fmi }}Error;
}

EXPORT {{ fmi }}Status F(Terminate)({{ component }} instance) {
  return ({{ fmi }}Status)enter((Instance *)instance, RUNNING, TERMINATED, "{{ fmi }}Terminate");
}

EXPORT {{ fmi }}Status F(Reset)({{ component }} instance) {
  Instance *m = (Instance *)instance;
  {{ refuse_unless("Reset", "READABLE") }}
  restart(&m->core);
  return {{ fmi }}OK;
}

EXPORT {{ fmi }}Status F(Get{{ state }})({{ component }} instance, {{ fmi }}{{ state }} *state) {
  Instance *m = (Instance *)instance;
  {{ refuse_unless("Get" ~ state, "READABLE") }}
  {{ refuse_null("Get" ~ state, "state") }}
  return keep(m, &m->core, state);
}

EXPORT {{ fmi }}Status F(Set{{ state }})({{ component }} instance, {{ fmi }}{{ state }} state) {
  Instance *m = (Instance *)instance;
  return permitted(m, READABLE, "{{ fmi }}Set{{ state }}") ? ({{ fmi }}Status)restore(m, (const Saved *)state) : {{ fmi }}Error;
}

EXPORT {{ fmi }}Status F(Free{{ state }})({{ component }} instance, {{ fmi }}{{ state }} *state) {
  Instance *m = (Instance *)instance;
  {{ refuse_unless("Free" ~ state, "READABLE") }}
  if (state != NULL && *state != NULL) {
    {{ release }}(*state);
    *state = NULL;
  }
  return {{ fmi }}OK;
}

EXPORT {{ fmi }}Status F(Serialized{{ state }}Size)({{ component }} instance, {{ fmi }}{{ state }} state, size_t *size) {
  Instance *m = (Instance *)instance;
  (void)state;
  {{ refuse_unless("Serialized" ~ state ~ "Size", "READABLE") }}
  {{ refuse_null("Serialized" ~ state ~ "Size", "size") }}
  *size = sizeof(Saved);
  return {{ fmi }}OK;
}

EXPORT {{ fmi }}Status F(Serialize{{ state }})({{ component }} instance, {{ fmi }}{{ state }} state, {{ fmi }}Byte bytes[], size_t size) {
  Instance *m = (Instance *)instance;
  return permitted(m, READABLE, "{{ fmi }}Serialize{{ state }}")
    ? ({{ fmi }}Status)serialize(m, (const Saved *)state, (unsigned char *)bytes, size) : {{ fmi }}Error;
}

EXPORT {{ fmi }}Status F({{ deserialize }}{{ state }})({{ component }} instance, const {{ fmi }}Byte bytes[], size_t size,
                                         {{ fmi }}{{ state }} *state) {
  Instance *m = (Instance *)instance;
  Saved saved;
  int status;
  {{ refuse_unless(deserialize ~ state, "READABLE") }}
  {{ refuse_null(deserialize ~ state, "state") }}
  status = deserialize(m, (const unsigned char *)bytes, size, &saved);
  return status == OK ? keep(m, &saved.core, state) : ({{ fmi }}Status)status;
}

{% if fmi == "fmi2" %}
#if MODEL_EXCHANGE
{% endif %}
EXPORT {{ fmi }}Status F(EnterEventMode)({{ component }} instance) {
  int modes = MODEL_EXCHANGE ? CONTINUOUS | EVENT : 0;
  return ({{ fmi }}Status)enter((Instance *)instance, modes, EVENT, "{{ fmi }}EnterEventMode");
}

EXPORT {{ fmi }}Status F(EnterContinuousTimeMode)({{ component }} instance) {
  return ({{ fmi }}Status)enter((Instance *)instance, EVENT, CONTINUOUS, "{{ fmi }}EnterContinuousTimeMode");
}

EXPORT {{ fmi }}Status F(CompletedIntegratorStep)({{ component }} instance, {{ fmi }}Boolean final, {{ fmi }}Boolean *enter_event_mode,
                                             {{ fmi }}Boolean *terminate) {
  Instance *m = (Instance *)instance;
  (void)final;
  {{ refuse_unless("CompletedIntegratorStep", "CONTINUOUS") }}
  {{ refuse_null("CompletedIntegratorStep", "enter_event_mode", "terminate") }}
  *enter_event_mode = *terminate = 0;
  return {{ fmi }}OK;
}

EXPORT {{ fmi }}Status F(GetEventIndicators)({{ component }} instance, {{ fmi }}{{ reals }} indicators[], size_t n) {
  Instance *m = (Instance *)instance;
  (void)indicators;
  {{ refuse_unless("GetEventIndicators", "READABLE & ~INSTANTIATED" if fmi == "fmi2" else "READABLE") }}
  return n == 0 ? {{ fmi }}OK : ({{ fmi }}Status)report(m, ERROR, "{{ fmi }}GetEventIndicators: there are none");
}
{% if fmi == "fmi2" %}
#endif
{% endif %}

#if MODEL_EXCHANGE
EXPORT {{ fmi }}Status F(SetTime)({{ component }} instance, {{ fmi }}{{ reals }} time) {
  Instance *m = (Instance *)instance;
  return permitted(m, CONTINUOUS | EVENT, "{{ fmi }}SetTime") ? ({{ fmi }}Status)set_time(m, time) : {{ fmi }}Error;
}

EXPORT {{ fmi }}Status F(SetContinuousStates)({{ component }} instance, const {{ fmi }}{{ reals }} x[], size_t n) {
  Instance *m = (Instance *)instance;
  return permitted(m, CONTINUOUS | EVENT, "{{ fmi }}SetContinuousStates") ? ({{ fmi }}Status)set_states(m, x, n) : {{ fmi }}Error;
}

#define STATES(name, status, what, from)                                                              \
  EXPORT {{ fmi }}Status F(name)({{ component }} instance, {{ fmi }}{{ reals }} values[], size_t n) { \
    Instance *m = (Instance *)instance;                                                               \
    return permitted(m, READABLE & ~INSTANTIATED, "{{ fmi }}" #name)                                  \
      ? ({{ fmi }}Status)give(m, status, what, from, values, n) : {{ fmi }}Error;                     \
  }

STATES(GetContinuousStates, prepare(m), "states", m->core.x)
STATES({{ get_derivatives }}, differentiate(m), "derivatives", m->core.derivatives)
STATES(GetNominalsOfContinuousStates, OK, "nominals", state_nominal)
#endif
