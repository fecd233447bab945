// Numbers as people type them, for fields with inputmode="decimal".
const NUMBER = /^[-−]?(\d+[.,]?\d*|[.,]\d+)$/;

// With a comma or a point; NaN for everything else, an empty text too.
export function numberOf(text) {
  const typed = text.trim();
  return NUMBER.test(typed) ? Number(typed.replace("−", "-").replace(",", ".")) : NaN;
}

// The fields within an element that hold something else; each is marked, and the others are not.
export function unreadable(root) {
  return [...root.querySelectorAll('[inputmode="decimal"]')].filter((field) => {
    const wrong = field.value.trim() !== "" && Number.isNaN(numberOf(field.value));
    field.setAttribute("aria-invalid", String(wrong));
    return wrong;
  });
}
