"use strict";
(() => {
  const controls = document.getElementById("controls");
  const tables = [...document.querySelectorAll("table")];
  const initial = tables.map((table) => [...table.tBodies[0].rows]);

  // The state of the page is the fragment of its address: metric=mse&hide=1,2&sort=0.3.up&at=claims
  const read = () => {
    const text = decodeURIComponent(location.hash.slice(1));
    if (!text.includes("=")) return { metric: "", hide: [], sort: "", at: text };
    const given = new URLSearchParams(text);
    const hide = (given.get("hide") || "").split(",").filter((number) => /^\d+$/.test(number));
    return { metric: given.get("metric") || "", hide, sort: given.get("sort") || "", at: given.get("at") || "" };
  };
  const address = (state) => {
    const parts = [];
    if (state.metric) parts.push("metric=" + encodeURIComponent(state.metric));
    if (state.hide.length) parts.push("hide=" + state.hide.join(","));
    if (state.sort) parts.push("sort=" + state.sort);
    if (!parts.length) return state.at;
    return parts.concat(state.at ? ["at=" + encodeURIComponent(state.at)] : []).join("&");
  };
  const change = (news) => {
    const fragment = address({ ...read(), at: "", ...news });
    if ("#" + fragment === location.hash || (!fragment && !location.hash)) return;
    history.pushState(null, "", fragment ? "#" + fragment : location.pathname + location.search);
    show();
  };

  const value = (row, column) => {
    const text = row.cells[column].textContent.trim().replace("\u2212", "-");
    if (/^[+-]?inf/.test(text)) return text[0] === "-" ? -Infinity : Infinity;
    const number = parseFloat(text);
    return Number.isNaN(number) ? text : number;
  };
  const compare = (a, b) => {
    if (typeof a === typeof b) return a < b ? -1 : a > b ? 1 : 0;
    return typeof a === "number" ? -1 : 1;
  };
  const sortTables = (sort) => {
    const [which, column, direction] = sort.split(".");
    tables.forEach((table, number) => {
      const chosen = sort !== "" && Number(which) === number && table.tHead.rows[0].cells[Number(column)];
      const rows = [...initial[number]];
      if (chosen) {
        const sign = direction === "down" ? -1 : 1;
        rows.sort((a, b) => sign * compare(value(a, Number(column)), value(b, Number(column))));
      }
      table.tBodies[0].append(...rows);
      [...table.tHead.rows[0].cells].forEach((cell, place) => {
        const on = chosen && place === Number(column);
        if (on) cell.setAttribute("aria-sort", direction === "down" ? "descending" : "ascending");
        else cell.removeAttribute("aria-sort");
      });
    });
  };

  const unfold = (element) => {
    for (let each = element.parentElement; each; each = each.parentElement) if (each.tagName === "DETAILS") each.open = true;
  };
  const show = () => {
    const state = read();
    document.querySelectorAll("[data-method]").forEach((each) => {
      each.classList.toggle("hidden", state.hide.includes(each.dataset.method));
    });
    const known = [...document.querySelectorAll(".of-metric")].some((each) => each.dataset.metric === state.metric);
    document.querySelectorAll(".of-metric").forEach((each) => {
      const chosen = known && each.dataset.metric === state.metric;
      each.classList.toggle("hidden", known && !chosen);
      if (chosen) unfold(each);
    });
    document.querySelectorAll("details").forEach((each) => {
      const inside = [...each.querySelectorAll(".of-metric")];
      const empty = inside.length > 0 && inside.every((one) => one.classList.contains("hidden"));
      each.classList.toggle("hidden", empty);
    });
    if (controls) {
      controls.querySelectorAll("[name=method]").forEach((box) => { box.checked = !state.hide.includes(box.value); });
      const select = controls.querySelector("[name=metric]");
      if (select) select.value = known ? state.metric : "";
    }
    sortTables(state.sort);
    const place = state.at && document.getElementById(state.at);
    if (place) {
      unfold(place);
      place.scrollIntoView();
    }
  };

  tables.forEach((table, number) => {
    if (initial[number].length < 2) return;
    [...table.tHead.rows[0].cells].forEach((cell, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...cell.childNodes);
      button.title = "Sort by this column";
      button.addEventListener("click", () => {
        const [up, down] = [number + "." + column + ".up", number + "." + column + ".down"];
        const now = read().sort;
        change({ sort: now === up ? down : now === down ? "" : up });
      });
      cell.append(button);
    });
  });
  if (controls) {
    controls.hidden = false;
    controls.addEventListener("submit", (event) => event.preventDefault());
    controls.addEventListener("change", () => {
      const boxes = [...controls.querySelectorAll("[name=method]")];
      const select = controls.querySelector("[name=metric]");
      const hide = boxes.filter((box) => !box.checked).map((box) => box.value);
      change({ hide, metric: select ? select.value : "" });
    });
  }
  // A link to a section keeps the state, which it would replace otherwise.
  document.addEventListener("click", (event) => {
    const link = event.target.closest("a[href^='#']");
    const state = read();
    if (!link || !(state.metric || state.hide.length || state.sort)) return;
    event.preventDefault();
    change({ at: link.getAttribute("href").slice(1) });
  });
  // Folded parts are printed, too.
  let opened = [];
  window.addEventListener("beforeprint", () => {
    opened = [...document.querySelectorAll("details:not([open])")];
    opened.forEach((each) => { each.open = true; });
  });
  window.addEventListener("afterprint", () => opened.forEach((each) => { each.open = false; }));
  window.addEventListener("hashchange", show);
  window.addEventListener("popstate", show);
  show();
})();
