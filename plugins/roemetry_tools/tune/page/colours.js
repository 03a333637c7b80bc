// Colours that keep apart for colour-blind eyes: neighbours of twelve differ for all of them.
export const ON_DARK = [
  "#E78AC3", "#8FA2FF", "#2FB592", "#F0E442", "#B8A22E", "#56B4E9",
  "#D9F2FF", "#FFB14A", "#C9A0FF", "#5FD8D8", "#F2D6B3", "#9AD14B",
];
export const ON_PAPER = [
  "#B71D7C", "#3F5BE0", "#187059", "#7A7000", "#726317", "#0D689C",
  "#2F6E8C", "#A65A00", "#7E3FD0", "#166E6E", "#8E5612", "#4A6E17",
];
export const onDark = (stripe) => ON_DARK[stripe % ON_DARK.length];
export const onPaper = (stripe) => ON_PAPER[stripe % ON_PAPER.length];
