${prefix}_status ${prefix}_default_parameters(${prefix}_parameters *parameters)
{
  static const ${prefix}_real values[${PREFIX}_PARAMETERS] = $values;
  ${prefix}_status status = ${PREFIX}_NULL_POINTER;
  size_t i;
  if (parameters != NULL) {
    for (i = 0U; i < (size_t)${PREFIX}_PARAMETERS; ++i) {
      parameters->value[i] = values[i];
    }
    status = ${PREFIX}_OK;
  }
  return status;
}
