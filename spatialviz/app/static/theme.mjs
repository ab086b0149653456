/* Before the first paint, and so no module: the theme chosen on this page before, else that of `view --theme`, else the
system's. What is chosen here is kept (`calls.theme` of page.mjs). */
{
  const root = document.documentElement, light = matchMedia('(prefers-color-scheme: light)');
  let chosen = '';
  try { chosen = localStorage.getItem('chosen-theme') || ''; } catch { /* nothing is kept */ }
  root.dataset.theme = chosen || root.dataset.given || (light.matches ? 'light' : 'dark');
}
