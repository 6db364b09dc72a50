/* Calls every function of the bundle once, with inputs that it accepts. */
#include <stdio.h>
#include <stdlib.h>

#include "${prefix}_control.h"
$foreign_includes
static ${prefix}_real workspace[${PREFIX}_WORKSPACE];

int main(void)
{
$parameters_declaration  ${prefix}_status status;
  int failures = 0;
  printf("%s: machine %s\n", ${prefix}_build_info()->bundle_sha256, ${prefix}_build_info()->machine);
$calls
  return failures ? EXIT_FAILURE : EXIT_SUCCESS;
}
