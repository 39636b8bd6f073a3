const problems = [];

/** Shows what went wrong at the top of the page, and records it in data-errors of the root element. */
function showProblem(where, error) {
  const problem = `${where}: ${error?.message ?? error}`;
  if (!problems.includes(problem)) problems.push(problem);
  document.documentElement.dataset.errors = JSON.stringify(problems);
  const box = document.getElementById("errors");
  box.hidden = false;
  box.className = "notice bad";
  box.textContent = `Part of this report could not be drawn. The numbers in the JSON files beside it are not affected. ${problems.join(" · ")}`;
}

/** What `draw` returns, or null when it fails: one broken section must not take the others with it. */
function attempt(where, draw) {
  try {
    return draw();
  } catch (error) {
    showProblem(where, error);
    return null;
  }
}

addEventListener("error", (event) => showProblem("Script", event.message));
addEventListener("unhandledrejection", (event) => showProblem("Script", event.reason));
