// What goes wrong in a page, noted before its own scripts run.
window.problems = [];
addEventListener("error", e => problems.push(String(e.message)));
addEventListener("unhandledrejection", e => problems.push(String(e.reason)));
addEventListener("securitypolicyviolation", e => problems.push(e.violatedDirective));
for (const name of ["error", "warn"]) console[name] = (...told) => problems.push(told.join(" "));
