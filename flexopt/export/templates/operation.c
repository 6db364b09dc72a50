${prefix}_status ${prefix}_${name}($arguments)
{
$tables  ${prefix}_status status = ${prefix}_check_call($given,
      workspace, workspace_length, ${PREFIX}_${NAME}_WORKSPACE);
$checks
  if (status == ${PREFIX}_OK) {
$pointers
    if ($call != 0) {
      status = ${PREFIX}_NUMERICAL_FAILURE;
    }
  }
$guards
  if (status == ${PREFIX}_OK) {
    status = ${prefix}_check_results(workspace, ${results}U);
  }
  if (status == ${PREFIX}_OK) {
$copies
    status = $remark;
  }
  return status;
}
