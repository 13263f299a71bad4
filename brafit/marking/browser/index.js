// Which scans are done, as this browser remembers; pages of files share its store in most browsers.
"use strict";
(function () {
  const show = () => {
    let done = 0;
    for (const row of document.querySelectorAll("tr[data-key]")) {
      let kept = null;
      try {
        kept = JSON.parse(localStorage.getItem(row.dataset.key));
      } catch {
        /* no store for pages of files */
      }
      const cell = row.querySelector(".state"),
        when = kept && new Date(kept.savedAt || kept.editedAt).toLocaleString();
      // A scan is done once it is saved and a person looked at all marks in it.
      const saved = kept && kept.savedAt && !kept.dirty,
        unseen = (kept && kept.unseen) || [];
      const words = !kept
        ? row.dataset.start
        : !saved
          ? `begun, not saved ${when}`
          : unseen.length
            ? `saved, not looked at: ${unseen.join(" and ")} ${when}`
            : `saved ${when}`;
      const state = !kept ? row.dataset.state : saved && !unseen.length ? "done" : "begun";
      cell.textContent = words;
      cell.dataset.value = { done: "0", begun: "1", todo: "2" }[state] + words;
      cell.className = `state ${state}`;
      done += state === "done";
    }
    document.getElementById("done").textContent = String(done);
  };
  addEventListener("pageshow", show);
  addEventListener("focus", show);
  addEventListener("storage", show);
  show();
})();
