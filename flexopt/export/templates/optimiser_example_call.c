  {
{{ example | indent(4, first=True) -}}
{{ "    " }}printf("optimiser: status %d, ", (int)found);
    if (found < {{ PREFIX }}_OPTIMISER_NULL_POINTER) {
      printf("%s", (found == {{ PREFIX }}_OPTIMISER_CONVERGED) ? "an optimum" : "feasible, not proved to be an optimum");
      printf("; V %.9g at z[0] %.9g ...", (double)answer.value, (double)answer.z[0]);
    } else {
      printf("no answer");
      ++failures;
    }
    printf("\n");
  }
