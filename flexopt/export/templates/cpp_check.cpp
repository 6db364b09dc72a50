// The bundle from C++: the header compiles, the library links, a call succeeds and a refusal refuses.
#include <cstdio>
#include <cstring>
#include <vector>

#include "${prefix}_control.h"

int main() {
  std::vector<${prefix}_real> workspace(${PREFIX}_WORKSPACE);
$body
  const bool same = std::strcmp(${prefix}_build_info()->bundle_sha256, ${PREFIX}_BUNDLE_SHA256) == 0;
  const bool passed = same && good == ${PREFIX}_OK && bad == ${PREFIX}_NULL_POINTER;
  std::printf("C++: %s\n", passed ? "passed" : "FAILED");
  return passed ? 0 : 1;
}
