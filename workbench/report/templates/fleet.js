(function () {
  "use strict";
  var table = document.getElementById("ranking");
  if (!table) { return; }
  var body = table.tBodies[0], rows = Array.prototype.slice.call(body.rows);
  var text = document.getElementById("f-text"), verdict = document.getElementById("f-verdict");
  var area = document.getElementById("f-area"), cycling = document.getElementById("f-cycling");
  var count = document.getElementById("f-count");
  function show() {
    var wanted = text.value.toLowerCase(), seen = 0;
    rows.forEach(function (row) {
      var fits = (!wanted || row.dataset.name.toLowerCase().indexOf(wanted) >= 0) &&
        (!verdict.value || row.dataset.verdict === verdict.value) &&
        (!area.value || row.dataset.area === area.value) &&
        (!cycling.checked || row.dataset.cycles === "1");
      row.hidden = !fits;
      if (fits) { seen += 1; }
    });
    count.textContent = seen + " of " + rows.length + " shown";
  }
  [text, verdict, area, cycling].forEach(function (field) { field.addEventListener("input", show); });
  Array.prototype.forEach.call(table.tHead.rows[0].cells, function (head, at) {
    if (!head.dataset.sort) { return; }
    head.tabIndex = 0;
    function sort() {
      var down = head.getAttribute("aria-sort") !== "descending";
      Array.prototype.forEach.call(table.tHead.rows[0].cells, function (other) { other.removeAttribute("aria-sort"); });
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      var numeric = head.dataset.sort === "number";
      rows.sort(function (a, b) {
        var x = a.cells[at].dataset.v, y = b.cells[at].dataset.v;
        if (numeric) {
          x = x === "" ? -Infinity : Number(x);
          y = y === "" ? -Infinity : Number(y);
          return (x === y ? 0 : x < y ? -1 : 1) * (down ? -1 : 1);
        }
        return x.localeCompare(y) * (down ? -1 : 1);
      });
      rows.forEach(function (row) { body.appendChild(row); });
    }
    head.addEventListener("click", sort);
    head.addEventListener("keydown", function (event) { if (event.key === "Enter") { sort(); } });
  });
  document.getElementById("filters").hidden = false;
  show();
})();
