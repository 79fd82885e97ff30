// Downloads: if one fails, the page shows the reason.

const NAMED = /filename="([^"]+)"/;

// Takes over the links with `download`; `place` shows why a download failed.
export function downloads(place) {
  document.addEventListener("click", async (event) => {
    const link = event.target.closest("a[download]");
    if (!link || link.href.startsWith("blob:")) return;
    event.preventDefault();
    place.textContent = "";
    try {
      const answer = await fetch(link.href);
      if (!answer.ok) throw new Error(await answer.text());
      saved(await answer.blob(), NAMED.exec(answer.headers.get("Content-Disposition"))?.[1] ?? "");
    } catch (error) {
      const why = error instanceof TypeError ? "The server does not answer." : error.message;
      place.textContent = `“${link.textContent}” was not downloaded. ${why}`;
    }
  });
}

function saved(content, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
