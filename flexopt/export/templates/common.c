/* Texts, build information$common_title. */
#include "${prefix}_internal.h"

const char *${prefix}_status_text(${prefix}_status status)
{
  const char *text = "unknown status";
  switch (status) {
$status_cases
  default:
    break;
  }
  return text;
}

int ${prefix}_has_output(${prefix}_status status)
{
  return ((status == ${PREFIX}_OK) || (status == ${PREFIX}_BEYOND_LIMIT)) ? 1 : 0;
}

const ${prefix}_info *${prefix}_build_info(void)
{
  static const ${prefix}_info info = {
    ${PREFIX}_FLEXOPT_VERSION,
    ${PREFIX}_MACHINE,
    ${PREFIX}_MACHINE_SHA256,
    ${PREFIX}_BUNDLE_SHA256,
    "$real",
    "$parts"
  };
  return &info;
}
$default_parameters
